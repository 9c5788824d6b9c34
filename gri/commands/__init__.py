"""The `gri` command. Begin with `cli`."""
