"""From a YAML file to a typed value, with errors that name file, line and field."""

import difflib
import re
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from cosim.scenario import Scenario, Traffic
from gri.errors import InputError
from gri.resources import shipped

T = TypeVar("T")


def load_scenario(name: str) -> Scenario:
    """The scenario of that name (shipped in `scenarios/`) or path."""
    path = find(name, "scenarios", "scenario")
    content = _parse(path)
    if isinstance(content.get("traffic"), str):
        traffic = find(content["traffic"], "scenarios/traffic", "traffic", beside=path)
        content["traffic"] = msgspec.to_builtins(_convert(traffic, _parse(traffic), Traffic))
    return _convert(path, content, Scenario)


def names_of(folder: str) -> list[str]:
    """Names of the YAML files that come with the project in a folder."""
    return sorted(path.stem for path in shipped(folder).glob("*.yaml"))


def find(name: str, folder: str, what: str, beside: Path | None = None) -> Path:
    """The file a person means by a name or a path; an InputError says what there is."""
    candidates = [Path(name), shipped(folder, f"{name}.yaml")]
    if beside is not None:
        candidates.insert(0, beside.parent / name)
    for path in candidates:
        if path.is_file():
            return path
    known = names_of(folder)
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"the shipped ones are {', '.join(known) or '(none)'}"
    raise InputError(f"unknown {what} {name!r}: expected the path of a YAML file or a shipped name; {hint}")


def _parse(path: Path) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
        content = yaml.safe_load(text)
        repeated = _repeated_key(yaml.compose(text))
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: not a text file ({error.reason} at byte {error.start}); expected UTF-8 YAML"
        ) from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{path}:{mark.line + 1}" if mark else str(path)
        raise InputError(f"{where}: not valid YAML: {getattr(error, 'problem', None) or error}") from None
    if repeated is not None:
        raise InputError(
            f"{path}:{repeated.start_mark.line + 1}: the key {repeated.value!r} stands here twice; keep one"
        )
    if not isinstance(content, dict):
        raise InputError(f"{path}: got {type(content).__name__}, expected a mapping of fields (see `cosim schema`)")
    return content


def _repeated_key(node: yaml.Node | None) -> yaml.ScalarNode | None:
    """The first key that a mapping holds twice; plain YAML loaders silently keep the last one."""
    if isinstance(node, yaml.MappingNode):
        seen = set()
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                return key
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else None)
            if found := _repeated_key(value):
                return found
    elif isinstance(node, yaml.SequenceNode):
        for value in node.value:
            if found := _repeated_key(value):
                return found
    return None


def _convert(path: Path, content: dict[str, Any], kind: type[T]) -> T:
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        raise InputError(_explain(path, str(error), kind)) from None


def _explain(path: Path, message: str, kind: type) -> str:
    """`file:line: field: what is wrong`, out of msgspec's `what is wrong - at `$.path``."""
    problem, _, location = message.partition(" - at `")
    location = location.rstrip("`").removeprefix("$").lstrip(".")
    unknown = re.match(r"Object contains unknown field `(.+)`", problem)
    if unknown:
        key = unknown[1]
        location = f"{location}.{key}".lstrip(".")
        close = difflib.get_close_matches(key, _field_names(kind), n=1)
        problem = f"unknown field {key!r}" + (f"; did you mean {close[0]!r}?" if close else "; see `cosim schema`")
    line = _line_of(path, location)
    return f"{path}{f':{line}' if line else ''}: {location + ': ' if location else ''}{problem}"


def _field_names(kind: type) -> list[str]:
    """All field names a file of that kind may hold, at any depth."""
    definitions = msgspec.json.schema(kind).get("$defs", {}).values()
    return sorted({name for definition in definitions for name in definition.get("properties", {})})


def _line_of(path: Path, location: str) -> int | None:
    """The line (from 1) of a path like `traffic.flows[1].per_hour`, as far as the file has it."""
    node, line = yaml.compose(path.read_text(encoding="utf-8")), None
    for part in re.findall(r"[^.\[\]]+", location):
        if isinstance(node, yaml.MappingNode):
            match = next(((k, v) for k, v in node.value if k.value == part), None)
            if match is None:
                return line
            line, node = match[0].start_mark.line + 1, match[1]
        elif isinstance(node, yaml.SequenceNode) and part.isdigit() and int(part) < len(node.value):
            node = node.value[int(part)]
            line = node.start_mark.line + 1
        else:
            return line
    return line


def override(scenario: Scenario, changes: dict[str, Any]) -> Scenario:
    """The scenario with top-level fields replaced, checked like a file."""
    content = {**msgspec.to_builtins(scenario), **changes}
    try:
        return msgspec.convert(content, Scenario)
    except msgspec.ValidationError as error:
        problem, _, location = str(error).partition(" - at `$.")
        raise InputError(f"--{location.rstrip('`').split('.')[0]}: {problem}") from None
