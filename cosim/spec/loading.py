"""From names, files and options to a checked scenario."""

import difflib
from pathlib import Path
from typing import Any

import msgspec

from cosim.spec.demand import Traffic
from cosim.spec.scenario import Replay, Scenario
from gri.config import parsed, read_yaml, typed
from gri.errors import InputError
from gri.resources import shipped


def load_scenario(name: str, beside: Path | None = None) -> Scenario:
    """The scenario of that name (shipped in `scenarios/`) or path; paths may be relative to the file `beside`."""
    path = find(name, "scenarios", "scenario", beside)
    content = parsed(path)
    if isinstance(content, dict) and isinstance(content.get("traffic"), str):
        content["traffic"] = traffic_of(content["traffic"], beside=path)
    return typed(content, Scenario, path)


def traffic_of(name: str, beside: Path) -> dict[str, Any]:
    """The content of a traffic file: of that name (shipped in `scenarios/traffic/`) or path."""
    return msgspec.to_builtins(read_yaml(find(name, "scenarios/traffic", "traffic", beside), Traffic))


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


def override(scenario: Scenario, changes: dict[str, Any]) -> Scenario:
    """The scenario with top-level fields replaced, checked like a file."""
    content = {**msgspec.to_builtins(scenario), **changes}
    try:
        return msgspec.convert(content, Scenario)
    except msgspec.ValidationError as error:
        problem, _, location = str(error).partition(" - at `$.")
        raise InputError(f"--{location.rstrip('`').split('.')[0]}: {problem}") from None


def replaying(scenario: Scenario, recording: Path) -> Scenario:
    """The scenario with another recording to replay."""
    if not isinstance(scenario.background, Replay):
        raise InputError(
            "--recording: this scenario's background is simulated; give one with background: {kind: replay}"
        )
    return override(scenario, {"background": {**msgspec.to_builtins(scenario.background), "recording": str(recording)}})
