"""`cosim doctor`: what this installation can do, and which core steps the simulation."""

from typing import Annotated

import typer

from gri.terminal import say


def doctor(
    build: Annotated[
        bool, typer.Option("--build-core", help="Compile the core with the system's C++ compiler and keep it.")
    ] = False,
) -> None:
    """Say which core makes the steps of a closed loop, and why.

    The compiled core is optional and gives the same results in less time. It
    needs a C++ compiler and the package eclipse-sumo (extra `sumo`) once, to
    build it. The environment variable COSIM_CORE chooses: auto (the default: the
    compiled core where it is built), python, or compiled (or an error).
    """
    from importlib.metadata import version

    from cosim.core import build_core, core_status
    from cosim.core.library import library
    from cosim.core.numpy_loops import loops

    if build:
        say(f"built {build_core()}")
    status = core_status()
    name, reason = ("compiled", f"{status.library}; {status.reason}") if status.library else ("Python", status.reason)
    if library() is not None and loops() is None:
        name, reason = "Python", "the compiled core cannot call the functions of this version of numpy"
    say(f"core: {name} ({reason})")
    say(f"libsumo {version('libsumo')}, numpy {version('numpy')}, torch {version('torch')}")
