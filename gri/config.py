"""Reading configuration: YAML in, one frozen typed value out, and errors that name file, line and field."""

import re
from pathlib import Path
from typing import TypeVar

import msgspec
import yaml

from gri.errors import InputError

T = TypeVar("T")


def read_yaml(path: Path | str, kind: type[T]) -> T:
    """The typed value of a YAML file; unknown fields and wrong types are `InputError`s."""
    text = read_text(Path(path))
    try:
        return msgspec.convert(yaml.safe_load(text), kind)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f":{mark.line + 1}" if mark else ""
        raise InputError(f"{path}{where}: not valid YAML ({getattr(error, 'problem', error)})") from error
    except msgspec.ValidationError as error:
        raise InputError(_explained(str(error), text, path)) from error


def read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise InputError(f"{path}: cannot be read ({reason}); give the path of a YAML file") from error


def _explained(message: str, text: str, path: Path | str) -> str:
    """msgspec's message with the line of the field it means."""
    found = re.search(r" - at `(?:key in )?\$\.?([^`]*)`", message)
    fields = re.split(r"\.|(?=\[)", found[1]) if found and found[1] else []
    unknown = re.search(r"unknown field `([^`]*)`", message)
    missing = re.search(r"missing required field `([^`]*)`", message)
    plain = message.split(" - at ")[0]
    name = ".".join([*fields, *([unknown[1]] if unknown else []), *([missing[1]] if missing else [])])
    line = _line([*fields, unknown[1]] if unknown else fields, text)
    place = f"{path}:{line}" if line else str(path)
    hint = "remove or correct it" if unknown else "correct it"
    return f"{place}: {f'field {name}: ' if name else ''}{plain[:1].lower()}{plain[1:]}; {hint}"


def _line(fields: list[str], text: str) -> int | None:
    """Line on which a field stands, counted from 1."""
    node = yaml.compose(text)
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
