"""Read configurations: a YAML file becomes one frozen typed value; errors name the file, the line and the field."""

import difflib
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from gri.errors import InputError

T = TypeVar("T")


def read_yaml(path: Path | str, kind: type[T]) -> T:
    """The typed value of a YAML file.

    Raises `InputError` if the file cannot be read, is not valid YAML, has unknown or repeated fields, or values of a
    wrong type.
    """
    return typed(parsed(path), kind, path)


def parsed(path: Path | str) -> Any:
    """The content of a YAML file as dicts, lists and numbers. Raises `InputError` as `read_yaml` does."""
    text = _text(Path(path))
    try:
        content, tree = yaml.safe_load(text), yaml.compose(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f":{mark.line + 1}" if mark else ""
        reason = " ".join(str(getattr(error, "problem", error)).split())
        raise InputError(f"{path}{where}: not valid YAML ({reason})") from error
    except ValueError as error:  # an impossible date, such as 2026-02-30
        raise InputError(f"{path}: not valid YAML ({error})") from error
    for node, problem in _problems(tree):
        raise InputError(f"{path}:{node.start_mark.line + 1}: {problem}")
    return content


def typed(content: Any, kind: type[T], path: Path | str) -> T:
    """Plain content as a typed value. Raises `InputError`, which names `path`."""
    return checked(content, kind, path)


def checked(content: Any, kind: Any, path: Path | str, under: Sequence[str] = ()) -> Any:
    """Plain content as a value of `kind`, which may be a union. `under` are the fields of the file that contain it.

    Raises `InputError`, which names `path`, the line and the field.
    """
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        raise InputError(_explained(str(error), kind, path, under)) from error
    except OverflowError as error:
        raise located(path, under, f"it has a number that is too large ({error}); give a smaller one") from error


def located(path: Path | str, fields: Sequence[str], problem: str) -> InputError:
    """The error for a problem with a field of a YAML file: `file:line: field a.b[0]: problem`."""
    line = _line(list(fields), Path(path))
    name = ".".join(fields).replace(".[", "[")
    return InputError(f"{path}{f':{line}' if line else ''}: {f'field {name}: ' if name else ''}{problem}")


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise InputError(f"{path}: cannot be read ({reason}); give the path of a YAML file") from error


def _problems(root: yaml.Node | None) -> Iterator[tuple[yaml.Node, str]]:
    """What YAML allows and a configuration must not have, with the place in the file.

    These are repeated keys (loaders silently keep the last one), numbers that are not finite, and content that contains
    itself.
    """
    waiting: list[tuple[yaml.Node, tuple[yaml.Node, ...]]] = [] if root is None else [(root, ())]
    while waiting:
        node, above = waiting.pop()
        if node in above:
            yield node, "an alias refers to content that contains it; write the values out"
            return
        if node.tag == "tag:yaml.org,2002:float" and node.value.lower().lstrip("+-") in (".inf", ".nan"):
            yield node, f"got {node.value}, expected a finite number"
        inside = []
        if isinstance(node, yaml.MappingNode):
            keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
            for key, value in node.value:
                if isinstance(key, yaml.ScalarNode) and keys.count(key.value) > 1:
                    yield key, f"field {key.value} is given twice; keep one"
                inside.append(value)
        elif isinstance(node, yaml.SequenceNode):
            inside = node.value
        waiting += [(child, (*above, node)) for child in reversed(inside)]


def _explained(message: str, kind: Any, path: Path | str, under: Sequence[str]) -> str:
    """msgspec's message as `file:line: field name: what is wrong; what to do`."""
    found = re.search(r" - at `(?:key in )?\$\.?([^`]*)`", message)
    fields = [*under, *(re.split(r"\.|(?=\[)", found[1]) if found and found[1] else [])]
    unknown = re.search(r"unknown field `([^`]*)`", message)
    missing = re.search(r"missing required field `([^`]*)`", message)
    problem, hint = message.split(" - at ")[0], "correct it"
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
    node = yaml.compose(_text(path))
    line = None
    for field in fields:
        if isinstance(node, yaml.MappingNode):
            entry = next(((k, v) for k, v in node.value if k.value == field), None)
            if entry is None:
                return line
            line, node = entry[0].start_mark.line + 1, entry[1]
        elif isinstance(node, yaml.SequenceNode) and (index := re.fullmatch(r"\[(\d+)\]", field)):
            node = node.value[int(index[1])]
            line = node.start_mark.line + 1
    return line
