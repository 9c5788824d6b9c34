"""Reading and checking scenarios, by name or path and with changes from options."""

import difflib
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from cosim.spec.demand import Traffic
from cosim.spec.perturbations import RENAMED
from cosim.spec.scenario import Replay, Scenario
from cosim.spec.settings import OPTION, overlay, settings_of
from cosim.spec.sumo_configuration import read_configuration
from gri.config import located, parsed, read_yaml, typed, unbounded_numbers
from gri.errors import InputError
from gri.resources import is_file, shipped


def load_scenario(
    name: str, beside: Path | None = None, *, max_work: float | None = None, settings: Sequence[str] = ()
) -> Scenario:
    """The scenario of that name (shipped in `scenarios/`) or path; a path may be relative to the folder of `beside`.

    `max_work` takes the place of the scenario's own, which says how much work is allowed. `settings` are changes such
    as "group.max_gap=20"; files that they name are found in the working folder.

    Raises `InputError` with file, line and field of a mistake.
    """
    changes = settings_of(settings)
    if isinstance(changes.get("max_work"), int | float) and max_work is None:
        max_work = changes["max_work"]
    path = find_file(name, "scenarios", "scenario", beside)
    content = parsed(path)
    if isinstance(content, dict) and isinstance(content.get("traffic"), str):
        content["traffic"] = traffic_content(content["traffic"], beside=path)
    elif isinstance(content, dict) and isinstance(content.get("traffic"), dict):
        content["traffic"] = beside_file(content["traffic"], path)
    if isinstance(content, dict) and max_work is not None:
        content["max_work"] = max_work
    for k, problem in _renamed_kinds(content):
        raise located(path, ["perturbations", f"[{k}]", "kind"], problem)
    scenario = typed(_with_net_of_configuration(files_beside(content, path)), Scenario, path)
    return changed(scenario, changes) if changes else scenario


def changed(scenario: Scenario, changes: dict[str, Any], option: str = OPTION) -> Scenario:
    """The scenario with nested fields replaced, such as `{"group": {"max_gap": 20}}`, checked like a file.

    `traffic` may be the name of a traffic file. Raises `InputError`, which names `option` and the field.
    """
    if isinstance(changes.get("traffic"), str):
        changes = {**changes, "traffic": traffic_content(changes["traffic"], beside=Path(option))}
    content = overlay(msgspec.to_builtins(scenario), changes)
    for k, problem in _renamed_kinds(content):
        raise located(option, ["perturbations", f"[{k}]", "kind"], problem)
    return typed(content, Scenario, option)


def files_beside(content: Any, path: Path) -> Any:
    """The content of a scenario file with the paths of the files that stand beside it.

    These are net, checkpoint, Python file of the policy, and recording. Other names remain as they are: they are found
    in the working folder, or are shipped.
    """
    if not isinstance(content, dict):
        return content
    result = dict(content)
    if isinstance(shares := content.get("shares"), dict):
        result["shares"] = {name: files_beside(part, path) for name, part in shares.items()}
    for field, inner in ((None, "net"), ("policy", "checkpoint"), ("policy", "object"), ("background", "recording")):
        holder = result if field is None else result.get(field)
        if not isinstance(holder, dict) or not isinstance(given := holder.get(inner), str):
            continue
        name, colon, rest = given.rpartition(":") if inner == "object" else (given, "", "")
        if name and is_file(path.parent / name):
            placed = {**holder, inner: f"{path.parent / name}{colon}{rest}"}
            result = placed if field is None else {**result, field: placed}
    return result


def _renamed_kinds(content: Any) -> Iterator[tuple[int, str]]:
    """The perturbations of a scenario that have another kind since version 0.1: their numbers and what to write."""
    blocks = content.get("perturbations") if isinstance(content, dict) else None
    for k, block in enumerate(blocks if isinstance(blocks, list | tuple) else ()):
        kind = block.get("kind") if isinstance(block, dict) else None
        if isinstance(kind, str) and kind in RENAMED:
            yield k, f"got {kind!r}, which has been replaced by {RENAMED[kind]}"


def traffic_content(name: str, beside: Path) -> dict[str, Any]:
    """The content of the traffic file of that name (shipped in `scenarios/traffic/`) or path, checked."""
    path = find_file(name, "scenarios/traffic", "traffic", beside)
    return beside_file(msgspec.to_builtins(read_yaml(path, Traffic)), path)


def beside_file(traffic: dict[str, Any], path: Path) -> dict[str, Any]:
    """The traffic with its own SUMO files looked for beside the YAML file `path`, where they are there."""

    def found(name: Any) -> Any:
        return str(path.parent / name) if isinstance(name, str) and is_file(path.parent / name) else name

    changed = {name: found(traffic[name]) for name in ("sumocfg",) if traffic.get(name)}
    for name in ("routes", "additional"):
        if isinstance(traffic.get(name), list | tuple):
            changed[name] = [found(part) for part in traffic[name]]
    return {**traffic, **changed}


def _with_net_of_configuration(content: Any) -> Any:
    """The scenario's content with the net of its SUMO configuration, where it names no net itself."""
    traffic = content.get("traffic") if isinstance(content, dict) else None
    if not isinstance(traffic, dict) or "net" in content or not isinstance(traffic.get("sumocfg"), str):
        return content
    net = read_configuration(Path(traffic["sumocfg"])).get("net-file") if traffic["sumocfg"] else None
    return {**content, "net": net} if net else content


def shipped_names(folder: str) -> list[str]:
    """Names of the shipped YAML files in a folder of the project, such as "scenarios"."""
    return sorted(path.stem for path in shipped(folder).glob("*.yaml"))


def find_file(name: str, folder: str, what: str, beside: Path | None = None) -> Path:
    """The YAML file of that path or shipped name. Raises `InputError` if there is none; `what` names its type there."""
    candidates = [Path(name), shipped(folder, f"{name}.yaml")]
    if beside is not None:
        candidates.insert(0, beside.parent / name)
    for path in candidates:
        if is_file(path):
            return path
    known = shipped_names(folder)
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"the shipped ones are {', '.join(known) or '(none)'}"
    raise InputError(f"unknown {what} {name!r}: expected the path of a YAML file or a shipped name; {hint}")


def override(scenario: Scenario, changes: dict[str, Any]) -> Scenario:
    """The scenario with some top-level fields replaced, checked like a file. Raises `InputError` for a wrong value."""
    content = {**msgspec.to_builtins(scenario), **changes}
    for fields, value in unbounded_numbers(content):
        raise InputError(f"{'.'.join(fields)}: got {value}, expected a finite number; change it")
    for k, problem in _renamed_kinds(content):
        raise InputError(f"perturbations[{k}].kind: {problem}")
    try:
        return msgspec.convert(content, Scenario)
    except (msgspec.ValidationError, OverflowError) as error:
        problem, _, place = str(error).partition(" - at `$.")
        place = place.rstrip("`")
        if not place:
            raise InputError(f"{problem.partition(' - at `')[0]}; change it") from None
        raise InputError(f"{place}: {problem}, got {_value_at(content, place)!r}; change it") from None


def _value_at(content: Any, place: str) -> Any:
    """The part of a specification that a path such as "policy.kind" or "perturbations[0].intensity" names."""
    for name in re.findall(r"[^.\[\]]+", place):
        content = content[int(name)] if isinstance(content, list | tuple) else content.get(name)
    return content


def with_recording(scenario: Scenario, recording: Path) -> Scenario:
    """The scenario with this recording as background. Raises `InputError` if its background is simulated."""
    if not isinstance(scenario.background, Replay):
        raise InputError(
            "--recording: the background of this scenario is simulated; choose one with background: {kind: replay}"
        )
    return override(scenario, {"background": {**msgspec.to_builtins(scenario.background), "recording": str(recording)}})


def json_schema() -> dict[str, Any]:
    """JSON Schema of a scenario file, for editors."""
    schema = msgspec.json.schema(Scenario)
    properties = schema["$defs"]["Scenario"]["properties"]
    properties["traffic"] = {
        "description": "a traffic description, or the name or path of a file that holds one",
        "anyOf": [properties["traffic"], {"type": "string"}],
    }
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "cosim scenario", **schema}
