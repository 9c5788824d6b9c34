"""Reading configuration: YAML in, one frozen typed value out, and errors that name file, line and field."""

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
    """The typed value of a YAML file; unknown fields, wrong types and repeated keys are `InputError`s."""
    return typed(parsed(path), kind, path)


def parsed(path: Path | str) -> Any:
    """The plain content of a YAML file."""
    text = _text(Path(path))
    try:
        content, tree = yaml.safe_load(text), yaml.compose(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f":{mark.line + 1}" if mark else ""
        reason = " ".join(str(getattr(error, "problem", error)).split())
        raise InputError(f"{path}{where}: not valid YAML ({reason})") from error
    except ValueError as error:  # of dates that are none
        raise InputError(f"{path}: not valid YAML ({error})") from error
    for node, problem in _problems(tree):
        raise InputError(f"{path}:{node.start_mark.line + 1}: {problem}")
    return content


def typed(content: Any, kind: type[T], path: Path | str) -> T:
    """Plain content as a typed value; `path` is the file that errors name."""
    return checked(content, kind, path)


def checked(content: Any, kind: Any, path: Path | str, under: Sequence[str] = ()) -> Any:
    """Content that stands `under` these fields of a file, as a value of a kind, which may be a union."""
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        raise InputError(_explained(str(error), kind, path, under)) from error
    except OverflowError as error:
        raise located(path, under, f"a number in it is too large ({error}); give a smaller one") from error


def located(path: Path | str, fields: Sequence[str], problem: str) -> InputError:
    """An error about a field of a YAML file: `file:line: field a.b[0]: problem`."""
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
    """What YAML allows and a configuration does not.

    Keys that stand twice (loaders silently keep the last one), numbers that are not finite, and content that contains
    itself.
    """
    waiting: list[tuple[yaml.Node, tuple[yaml.Node, ...]]] = [] if root is None else [(root, ())]
    while waiting:
        node, above = waiting.pop()
        if node in above:
            yield node, "an alias refers to what contains it; write the values out"
            return
        if node.tag == "tag:yaml.org,2002:float" and node.value.lower().lstrip("+-") in (".inf", ".nan"):
            yield node, f"got {node.value}, expected a finite number"
        inside = []
        if isinstance(node, yaml.MappingNode):
            keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
            for key, value in node.value:
                if isinstance(key, yaml.ScalarNode) and keys.count(key.value) > 1:
                    yield key, f"field {key.value} stands twice in its mapping; keep one"
                inside.append(value)
        elif isinstance(node, yaml.SequenceNode):
            inside = node.value
        waiting += [(child, (*above, node)) for child in reversed(inside)]


def _explained(message: str, kind: Any, path: Path | str, under: Sequence[str]) -> str:
    """`file:line: field name: what is wrong; what to do` out of msgspec's message."""
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
    """All field names a value of that kind may hold, at any depth."""
    definitions = msgspec.json.schema(kind).get("$defs", {}).values()
    return sorted({name for definition in definitions for name in definition.get("properties", {})})


def _line(fields: list[str], path: Path) -> int | None:
    """Line on which a field stands, counted from 1, as far as the file has it."""
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
