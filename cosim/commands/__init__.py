"""The `cosim` command: one file per group of subcommands, and the reference of all YAML fields. Begin with `cli`."""
