"""Write docs/reference/commands.md: every command of `cosim` and `gri` with its arguments and options.

`python docs/tools/commands.py` writes it; tests/docs/test_commands.py compares.
"""

import inspect
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from typer.main import get_command

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/reference/commands.md"
HEAD = """\
# Commands

The project has two commands. `cosim` runs SUMO; `gri` makes scenes, trains and evaluates models. Both print the same as
this page with `--help`. The page is written by `python docs/tools/commands.py`; do not edit it by hand.

Exit codes: 0 success, 1 failure, 2 wrong input, 3 complete but with fewer episodes than asked for (`cosim run` and
`cosim batch`), 130 stopped by Ctrl-C.
"""
KINDS = {str: "text", int: "integer", float: "number", Path: "path"}


def markdown() -> str:
    from cosim.commands.cli import app as cosim_app
    from gri.commands.cli import app as gri_app

    parts = [HEAD]
    for name, app in (("cosim", cosim_app), ("gri", gri_app)):
        command = get_command(app)
        parts += [f"## {name}\n", _text(command.help or "") + "\n", *_parameters(command), *_commands(name, command)]
    return "\n".join(parts).rstrip() + "\n"


def _commands(prefix: str, group: Any) -> Iterator[str]:
    for name, command in group.commands.items():
        if command.hidden:
            continue
        if hasattr(command, "commands"):
            yield from _commands(f"{prefix} {name}", command)
            continue
        yield f"### {prefix} {name}\n"
        yield _text(command.help or "") + "\n"
        arguments = [_name(parameter) for parameter in command.params if parameter.param_type_name == "argument"]
        yield f"```text\n{' '.join([prefix, name, *arguments])} [OPTIONS]\n```\n"
        yield from _parameters(command)


def _parameters(command: Any) -> Iterator[str]:
    shown = [p for p in command.params if not getattr(p, "hidden", False) and p.name != "help"]
    if not shown:
        return
    hints = get_type_hints(inspect.unwrap(command.callback))
    yield "| argument or option | value | meaning | default |\n|---|---|---|---|"
    for parameter in shown:
        is_flag = getattr(parameter, "is_flag", False)
        kind = "" if is_flag else _kind(hints[parameter.name])
        meaning = _text(getattr(parameter, "help", "") or "").replace("|", "\\|").replace("\n", " ")
        name = _name(parameter).replace("|", "\\|")
        yield f"| `{name}` | {kind} | {meaning} | {'' if is_flag else _default(parameter)} |"
    yield ""


def _name(parameter: Any) -> str:
    if parameter.param_type_name == "argument":
        return parameter.metavar or parameter.name.upper()
    return ", ".join([*parameter.opts, *parameter.secondary_opts])


def _kind(hint: Any) -> str:
    """What one types: "integer", "path", or the words to choose from."""
    if get_origin(hint) in (Union, types.UnionType):
        return _kind(next(part for part in get_args(hint) if part is not type(None)))
    if get_origin(hint) is Literal:
        return ", ".join(f"`{word}`" for word in get_args(hint))
    if get_origin(hint) is list:
        return f"{_kind(get_args(hint)[0])}, repeatable"
    if get_origin(hint) is tuple:
        return " ".join(_kind(part) for part in get_args(hint))
    return KINDS.get(hint) or ", ".join(f"`{member.value}`" for member in hint)


def _default(parameter: Any) -> str:
    if parameter.required:
        return "required"
    given = parameter.default not in (None, "", []) and not callable(parameter.default)
    return f"`{parameter.default}`" if given else ""


def _text(text: str) -> str:
    """Help texts escape square brackets for Rich; Markdown does not need that."""
    return inspect.cleandoc(text).replace("\\[", "[")


if __name__ == "__main__":
    PAGE.write_text(markdown())
    print(f"wrote {PAGE.relative_to(ROOT)}")
