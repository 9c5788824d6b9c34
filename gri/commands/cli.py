"""The `gri` command: its subcommands, and what happens when one fails."""

from typing import Annotated

import typer

from gri.commands.bench import app as bench_app
from gri.commands.infer import infer
from gri.commands.models import data, evaluate, teach, train
from gri.commands.ngsim import app as ngsim_app
from gri.commands.reproduce import reproduce
from gri.commands.scenes import app as scenes_app
from gri.errors import SYSTEM_ERRORS, InputError, refused_by_system
from gri.processes import stop_like_ctrl_c
from gri.terminal import fail, show_version, use_any_encoding

# Without a markup mode the help is plain text: units in square brackets, such as [m], would vanish as Rich markup.
app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
for _command in (data, train, teach, evaluate, infer, reproduce):
    app.command()(_command)
app.add_typer(scenes_app, name="scenes")
app.add_typer(ngsim_app, name="ngsim")
app.add_typer(bench_app, name="bench")


def _version(wanted: bool) -> bool:
    if wanted:
        show_version("gri")
    return wanted


@app.callback()
def gri(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Infer which vehicle follows, yields to or cuts in on which.

    Train a model: gri data, gri train, gri evaluate, in this order.
    """


def main() -> None:
    """Entry point. Errors are one line on stderr; the exit code is 2 for bad input, 1 for what the system refuses."""
    stop_like_ctrl_c()
    use_any_encoding()
    try:
        app()
    except InputError as error:
        fail(str(error), 2)
    except SYSTEM_ERRORS as error:
        fail(refused_by_system(error), 1)


if __name__ == "__main__":
    main()
