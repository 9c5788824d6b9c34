"""The files of a finished run, compared with the hashes in its manifest before anything is read from them."""

from pathlib import Path
from typing import Any

import msgspec

from cosim.spec.scenario import Scenario
from gri.errors import InputError, guarded_reading
from gri.storage.verification import DamagedError, check_digest, read_sealed, write_sealed

MANIFEST, SCENARIO = "manifest.json", "scenario.json"
FIX = "run the scenario again, or, for a run of a batch, `cosim batch` again"


class _Arguments(msgspec.Struct):
    """The arguments of a run with groups that readers use."""

    driver: str
    seed: int
    episodes: int
    starts: int = 0
    candidates_seen: int = 0
    candidates_failed: dict[str, int] = {}
    waiting_outside: int = 0
    waiting_outside_since: float | None = None


class _Manifest(msgspec.Struct):
    """The fields of a manifest that readers use."""

    arguments: dict[str, Any]
    results: dict[str, str]
    effects: list[dict[str, Any]] = []


def write_manifest(folder: Path, content: dict[str, Any]) -> None:
    """Write the manifest of a run, with its own hash as its last field."""
    write_sealed(folder / MANIFEST, content)


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a run. Errors: `InputError` if there is none, `DamagedError` if it has been changed."""
    if not (folder / MANIFEST).is_file():
        raise InputError(f"{folder}: no manifest.json in it; expected a run folder written by `cosim run`")
    content = read_sealed(folder / MANIFEST, FIX)
    try:
        msgspec.convert(content, _Manifest)
    except msgspec.ValidationError as error:
        raise DamagedError(f"{folder / MANIFEST}: {error}; {FIX}") from None
    return content


def read_group_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a run in which groups were driven. Errors as `read_manifest`."""
    content = read_manifest(folder)
    try:
        msgspec.convert(content["arguments"], _Arguments)
    except msgspec.ValidationError as error:
        raise DamagedError(f"{folder / MANIFEST}: arguments: {error}; {FIX}") from None
    return content


def verified_file(folder: Path, name: str) -> Path:
    """The path of a file of a run that is as it was written. Errors: `DamagedError`.

    Runs of version 0.1 have hashes of their tables only. A run without a manifest is not finished: its files are not
    verified, and `read_tables` refuses it.
    """
    if not (folder / MANIFEST).is_file():
        return folder / name
    results = read_manifest(folder)["results"]
    if name not in results and not name.endswith(".parquet"):
        return folder / name
    return check_digest(folder / name, results.get(name), FIX)


def has_file(folder: Path, name: str) -> bool:
    """Whether a run wrote a file of that name, even if it is not there any more."""
    return (folder / name).is_file() or ((folder / MANIFEST).is_file() and name in read_manifest(folder)["results"])


def verify_run(folder: Path) -> None:
    """Compare all files of a run with their hashes. Errors: `InputError` at the first that is not as it was written."""
    for name, wanted in read_manifest(folder)["results"].items():
        check_digest(folder / name, wanted, FIX)


def read_scenario(folder: Path) -> Scenario:
    """The scenario of a finished run."""
    path = verified_file(folder, SCENARIO)
    with guarded_reading(path, "scenario of a run", FIX):
        return msgspec.json.decode(path.read_bytes(), type=Scenario)
