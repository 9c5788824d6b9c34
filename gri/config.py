"""Read configurations: a YAML file becomes one frozen typed value; errors name the file, the line and the field."""

import difflib
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from gri.errors import InputError
from gri.yaml_content import read_content

T = TypeVar("T")
LONGEST_MESSAGE = 300  # characters of what is said about one field
FEW = 12  # names that an error lists


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
    for fields, value in unbounded_numbers(content):
        raise located(path, (*under, *fields), f"got {value}, expected a finite number")
    try:
        return msgspec.convert(content, kind)
    except (msgspec.ValidationError, OverflowError, RecursionError) as error:
        raise InputError(_explained(str(error), content, kind, path, under)) from error


def unbounded_numbers(content: Any) -> Iterator[tuple[tuple[str, ...], float]]:
    """The numbers of plain content that are not finite, each after its fields; ranges of fields let nan through."""
    waiting: list[tuple[tuple[str, ...], Any]] = [((), content)]
    while waiting:
        fields, value = waiting.pop()
        if isinstance(value, float) and not math.isfinite(value):
            yield fields, value
        if isinstance(value, Mapping):
            waiting += [((*fields, str(name)), inside) for name, inside in value.items()]
        elif isinstance(value, list | tuple):
            waiting += [((*fields, f"[{k}]"), inside) for k, inside in enumerate(value)]


def located(path: Path | str, fields: Sequence[str], problem: str) -> InputError:
    """The error for a problem with a field of a YAML file: `file:line: field a.b[0]: problem`.

    `path` may also be what gave the field instead of a file, such as `--set`.
    """
    line = _line(list(fields), Path(path)) if Path(path).exists() else None
    name = ".".join(fields).replace(".[", "[")
    return InputError(f"{path}{f':{line}' if line else ''}: {f'field {name}: ' if name else ''}{problem}")


def _explained(message: str, content: Any, kind: Any, path: Path | str, under: Sequence[str]) -> str:
    """msgspec's message as `file:line: field name: what is wrong; what to do`."""
    found = re.search(r" - at `(?:key in )?\$\.?([^`]*)`", message)
    inside = [*(re.split(r"\.|(?=\[)", found[1]) if found and found[1] else [])]
    fields = [*under, *inside]
    unknown = re.search(r"unknown field `([^`]*)`", message)
    missing = re.search(r"missing required field `([^`]*)`", message)
    problem, hint = " ".join(message.split(" - at `")[0].split()), "correct it"
    if re.match(r"Expected `\w+` (of length )?[<>]", problem):
        problem, hint = f"{problem}, got {_value_at(content, inside)!r}", "give a value in this range"
    if "expected `str`, got `int`" in problem.lower():
        hint = 'text that looks like a number needs quotes, such as "12"'
    if "expected `bool`" in problem.lower():
        hint = "write true or false"
    if re.match(r"Invalid (enum )?value", problem) and (known := _known_values(kind, inside)):
        close = difflib.get_close_matches(str(_value_at(content, inside)), known, n=1)
        hint = f"did you mean {close[0]!r}?" if close else f"expected one of {', '.join(known)}"
    if len(problem) > LONGEST_MESSAGE:
        problem = f"{problem[:LONGEST_MESSAGE]}…"
    if unknown:
        known = _field_names(kind, content, inside)
        close = difflib.get_close_matches(unknown[1], known, n=1)
        fix = f"expected one of {', '.join(known)}" if 0 < len(known) <= FEW else "remove or correct it"
        problem, hint = "unknown field", f"did you mean {close[0]!r}?" if close else fix
    fields += [found[1] for found in (unknown, missing) if found]
    return str(located(path, fields, f"{problem[:1].lower()}{problem[1:]}; {hint}"))


def _value_at(content: Any, fields: Sequence[str]) -> Any:
    """The part of plain content that a list of names such as ["policy", "kind"] or ["edges", "[0]"] leads to."""
    for name in fields:
        index = name.strip("[]")
        if isinstance(content, list | tuple) and index.isdecimal() and int(index) < len(content):
            content = content[int(index)]
        else:
            content = content.get(name) if isinstance(content, Mapping) else None
    return content


def _known_values(kind: Any, fields: Sequence[str]) -> list[str]:
    """The words that a field of that name may have; of all fields with this name where several types have one."""
    name = next((field for field in reversed(fields) if not field.startswith("[")), "")
    known: dict[str, None] = {}
    waiting = [definition.get("properties", {}).get(name, {}) for definition in _definitions(kind)]
    while waiting:
        schema = waiting.pop()
        known |= {str(value): None for value in schema.get("enum", ())}
        waiting += [*schema.get("anyOf", ()), *([schema["items"]] if isinstance(schema.get("items"), dict) else ())]
    return list(known)


def _definitions(kind: Any) -> list[dict[str, Any]]:
    """The JSON schemas of all types that a value of that kind may contain."""
    return list(msgspec.json.schema(kind).get("$defs", {}).values())


def _field_names(kind: Any, content: Any, fields: Sequence[str]) -> list[str]:
    """The field names that the mapping at a place of a value of that kind may have."""
    schema = msgspec.json.schema(kind)
    here = _schemas(schema, content, schema)
    for name in fields:
        content = _value_at(content, [name])
        inside = [
            of.get("properties", {}).get(name) or of.get("items") or of.get("additionalProperties") for of in here
        ]
        here = [found for of in inside if isinstance(of, dict) for found in _schemas(of, content, schema)]
    return sorted({name for of in here for name in of.get("properties", {})})


def _schemas(schema: dict[str, Any], content: Any, whole: dict[str, Any]) -> list[dict[str, Any]]:
    """The JSON schemas without references and alternatives that a schema stands for; of tagged ones, that of the tag.

    `content` is what is there, `whole` the schema with all definitions.
    """
    if "$ref" in schema:
        return _schemas(whole["$defs"][schema["$ref"].rpartition("/")[2]], content, whole)
    if "anyOf" in schema:
        return [found for of in schema["anyOf"] for found in _schemas(of, content, whole)]
    given = content if isinstance(content, Mapping) else {}
    tags = {name: of["enum"] for name, of in schema.get("properties", {}).items() if len(of.get("enum", ())) == 1}
    return [schema] if all(name not in given or given[name] in tag for name, tag in tags.items()) else []


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
