"""`python -m cosim` is the `cosim` command."""

from cosim.commands.cli import main

if __name__ == "__main__":
    main()
