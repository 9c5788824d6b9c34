"""The `gri` command: make scenes, train and score models, reproduce the paper's tables, cut scenes from recordings.

One file per group of subcommands; each command imports what it needs. Begin with `cli`.
"""
