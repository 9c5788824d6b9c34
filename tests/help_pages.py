"""The help of every command of a typer application, as it is printed, and what importing a command brings."""

import re
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import typer
from typer.main import get_command
from typer.testing import CliRunner

SLOW_MODULES = {"torch", "scipy", "pandas", "matplotlib", "libsumo", "pyarrow"}


def commands(command, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], object]]:
    """Every command and group below a click command, with its words."""
    yield path, command
    for name, child in getattr(command, "commands", {}).items():
        yield from commands(child, (*path, name))


def pages(app: typer.Typer) -> dict[str, tuple[Any, str]]:
    """Every command and its printed help at 80 columns, by its words."""
    found = {}
    for path, command in commands(get_command(app)):
        printed = CliRunner().invoke(app, [*path, "--help"], env={"COLUMNS": "80"})
        assert printed.exit_code == 0, printed.output
        found[" ".join(path)] = command, printed.output
    return found


def squeezed(text: str) -> str:
    """The text without white space, so that it does not matter where lines are wrapped."""
    return "".join(text.split())


def imported_by(module: str, *arguments: str) -> tuple[set[str], str, int]:
    """The slow modules that a command imports, what it prints to both streams, and its exit code."""
    code = f"""
import atexit, sys
atexit.register(lambda: print("imported:", *({SLOW_MODULES!r} & set(sys.modules))))
sys.argv = [{module!r}, *{arguments!r}]
from {module} import main
main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    output, _, names = done.stdout.rpartition("imported:")
    return set(names.split()), output + done.stderr, done.returncode


def assert_texts_with_units(pages: dict[str, tuple[Any, str]], units: set[tuple[str, str]]) -> None:
    """Every help text is printed whole; Rich would take units such as [s] and [m] for markup and drop them."""
    found = set()
    for name, (command, printed) in pages.items():
        for parameter in command.params:
            text = getattr(parameter, "help", None) or ""
            found |= {(name, unit) for unit in re.findall(r"\[[^\]]+\]", text)}
            assert squeezed(text) in squeezed(printed), (name, text)
    assert found >= units


def assert_fits_eighty_columns(pages: dict[str, tuple[Any, str]]) -> None:
    """No line is longer than 80 columns, and no command's text is cut off."""
    for name, (_, printed) in pages.items():
        assert all(len(line) <= 80 for line in printed.splitlines()), name
        if "Commands:" in printed:
            listed = printed.partition("Commands:")[2]
            assert not re.search(r"\.\.\.$", listed, re.MULTILINE), name
