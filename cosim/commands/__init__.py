"""The `cosim` command: one file per group of subcommands, and the reference of all fields of YAML files.

Each command imports what it needs, so that `--help` and mistakes need not wait for torch and SUMO. Begin with `cli`.
"""
