"""Read configurations: a YAML file becomes one frozen typed value; errors name the file, the line and the field."""

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from gri.errors import InputError
from gri.yaml_content import read_content

T = TypeVar("T")
LONGEST_MESSAGE = 300  # characters of what is said about one field


def read_yaml(path: Path | str, kind: type[T]) -> T:
    """The typed value of a YAML file.

    Raises `InputError` if the file cannot be read, is not valid YAML, has unknown or repeated fields, or values of a
    wrong type.
    """
    return typed(parsed(path), kind, path)


def parsed(path: Path | str) -> Any:
    """The content of a YAML file as dicts, lists and numbers. Raises `InputError` as `read_yaml` does."""
    return read_content(Path(path))[0]


def typed(content: Any, kind: type[T], path: Path | str) -> T:
    """Plain content as a typed value. Raises `InputError`, which names `path`."""
    return checked(content, kind, path)


def checked(content: Any, kind: Any, path: Path | str, under: Sequence[str] = ()) -> Any:
    """Plain content as a value of `kind`, which may be a union. `under` are the fields of the file that contain it.

    Raises `InputError`, which names `path`, the line and the field.
    """
    refuse_unbounded_numbers(content, path, under)
    try:
        return msgspec.convert(content, kind)
    except (msgspec.ValidationError, OverflowError, RecursionError) as error:
        raise InputError(_explained(str(error), kind, path, under)) from error


def refuse_unbounded_numbers(content: Any, path: Path | str, under: Sequence[str] = ()) -> None:
    """Raise `InputError` for a number that is not finite, which a range of a field need not exclude."""
    waiting: list[tuple[Any, tuple[str, ...]]] = [(content, tuple(under))]
    while waiting:
        value, fields = waiting.pop()
        if isinstance(value, float) and not math.isfinite(value):
            raise located(path, fields, f"got {value}, expected a finite number")
        if isinstance(value, Mapping):
            waiting += [(inside, (*fields, str(name))) for name, inside in value.items()]
        elif isinstance(value, list | tuple):
            waiting += [(inside, (*fields, f"[{k}]")) for k, inside in enumerate(value)]


def located(path: Path | str, fields: Sequence[str], problem: str) -> InputError:
    """The error for a problem with a field of a YAML file: `file:line: field a.b[0]: problem`."""
    line = _line(list(fields), Path(path))
    name = ".".join(fields).replace(".[", "[")
    return InputError(f"{path}{f':{line}' if line else ''}: {f'field {name}: ' if name else ''}{problem}")


def _explained(message: str, kind: Any, path: Path | str, under: Sequence[str]) -> str:
    """msgspec's message as `file:line: field name: what is wrong; what to do`."""
    found = re.search(r" - at `(?:key in )?\$\.?([^`]*)`", message)
    fields = [*under, *(re.split(r"\.|(?=\[)", found[1]) if found and found[1] else [])]
    unknown = re.search(r"unknown field `([^`]*)`", message)
    missing = re.search(r"missing required field `([^`]*)`", message)
    problem, hint = " ".join(message.split(" - at `")[0].split()), "correct it"
    if "expected `str`, got `int`" in problem.lower():
        hint = 'text that looks like a number needs quotes, such as "12"'
    if "expected `bool`" in problem.lower():
        hint = "write true or false"
    if len(problem) > LONGEST_MESSAGE:
        problem = f"{problem[:LONGEST_MESSAGE]}…"
    if unknown:
        close = difflib.get_close_matches(unknown[1], _field_names(kind), n=1)
        problem, hint = "unknown field", f"did you mean {close[0]!r}?" if close else "remove or correct it"
    fields += [found[1] for found in (unknown, missing) if found]
    return str(located(path, fields, f"{problem[:1].lower()}{problem[1:]}; {hint}"))


def _field_names(kind: Any) -> list[str]:
    """All field names that a value of that kind may have, at any depth."""
    definitions = msgspec.json.schema(kind).get("$defs", {}).values()
    return sorted({name for definition in definitions for name in definition.get("properties", {})})


def _line(fields: list[str], path: Path) -> int | None:
    """The line of a field, counted from 1; of the innermost field that contains it, if the file does not have it."""
    _, node = read_content(path)
    line = None
    for field in fields:
        if isinstance(node, yaml.MappingNode):
            entry = next(((k, v) for k, v in node.value if k.value == field), None)
            if entry is None:
                return line
            line, node = entry[0].start_mark.line + 1, entry[1]
        elif isinstance(node, yaml.SequenceNode) and (index := re.fullmatch(r"\[(\d+)\]", field)):
            if int(index[1]) >= len(node.value):
                return line
            node = node.value[int(index[1])]
            line = node.start_mark.line + 1
    return line
