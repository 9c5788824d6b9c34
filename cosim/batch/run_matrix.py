"""The runs of a batch file: single, checked scenarios, each with its labels and a hash of its content."""

import difflib
import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any

import msgspec

from cosim.batch.spec import NOMINAL, PLAIN, Batch, ExtraRun, Sweep
from cosim.spec.input_files import input_files, refuse_foreign_code, sha256
from cosim.spec.loading import files_beside, find_file, load_scenario, traffic_content
from cosim.spec.scenario import MAX_WORK, Driver, Scenario, policy_name
from cosim.spec.settings import overlay
from gri.config import checked, located, parsed, typed
from gri.errors import InputError

FORMAT = 4  # of the results of a run; with a new number every run is repeated
PACKAGES = ("gri-cosim", "libsumo", "numpy", "torch")  # whose versions a run depends on
NEWER = ("share", "shares")  # fields that are no part of the key of a run where they are not given


@dataclass(frozen=True, order=True)
class Cell:
    """The place of a run in the matrix; `intensity` is None for a nominal run."""

    scenario: str
    policy: str
    perturbation: str
    intensity: float | None
    variant: str
    seed: int

    def __str__(self) -> str:
        graded = "" if self.intensity is None else f" {self.intensity:g}"
        return f"{self.scenario} {self.policy} {self.perturbation}{graded} {self.variant} seed {self.seed}"


@dataclass(frozen=True)
class Run:
    """One run of a batch. `key` is the hash of everything on which its results depend."""

    cell: Cell
    scenario: Scenario
    key: str

    @property
    def id(self) -> str:
        """The name of its folder: a letter, so that it does not look like a number, and 11 digits of the key."""
        return f"r{self.key[:11]}"


def load_batch(name: str) -> tuple[Batch, Path]:
    """The batch of that name (shipped in `scenarios/batch/`) or path, and its file."""
    path = find_file(name, "scenarios/batch", "batch")
    content = parsed(path)
    if isinstance(content, dict):
        content = _files_beside(content, path)
        for field, kind in (("policies", Driver), ("perturbations", Sweep), ("variants", dict)):
            entries = content.get(field)
            for key, entry in entries.items() if isinstance(entries, dict) else ():
                checked(entry, kind, path, under=(field, str(key)))  # because msgspec does not name keys of mappings
    return typed(content, Batch, path), path


def _files_beside(content: dict[str, Any], path: Path) -> dict[str, Any]:
    """The content of a batch file with the paths of the files beside it that its policies and changes name."""
    result = {**content, "overrides": files_beside(content.get("overrides", {}), path)}
    for field, enclosing in (("policies", "policy"), ("variants", None)):
        if isinstance(entries := content.get(field), dict):
            result[field] = {
                name: files_beside(entry, path)
                if enclosing is None
                else files_beside({enclosing: entry}, path)[enclosing]
                for name, entry in entries.items()
            }
    return result


def refuse_foreign_code_of(batch: Batch, path: Path, allowed: bool) -> None:
    """Raise `InputError` where the batch, or one of its scenarios, names code outside its own folder."""
    refuse_foreign_code(msgspec.to_builtins(batch), path, allowed)
    for name in batch.scenarios:
        file = find_file(name, "scenarios", "scenario", beside=path)
        refuse_foreign_code(files_beside(parsed(file), file), file, allowed)


def expand(batch: Batch, path: Path, max_work: float | None = None) -> tuple[Run, ...]:
    """All runs of a batch, in the order of its file. Raises `InputError` with the name of the field that is wrong.

    `max_work` takes the place of that of all scenarios.
    """
    names = _KnownNames.of(batch, path, max_work if max_work is not None else batch.overrides.get("max_work"))
    matrix = _Matrix(batch, path, names)
    exclusions = _exclusions(batch, path, names)
    cells = {cell: None for cell in matrix.cells() if not any(_matches(cell, given) for given in exclusions)}
    for k, extra in enumerate(batch.include):
        cell = names.cell(extra, path, ("include", f"[{k}]"))
        if cell in cells:
            raise located(path, ("include", f"[{k}]"), f"the matrix already has this run ({cell}); remove it")
        cells[cell] = None
    if not cells:
        raise located(path, ("exclude",), "every run is excluded, so nothing is left to run; exclude less")
    return tuple(matrix.run(cell) for cell in cells)


def key_of(scenario: Scenario, labels: Mapping[str, Any]) -> str:
    """SHA-256 of everything on which the results of a run depend: scenario, its input files, labels and versions."""
    facts = {
        "format": FORMAT,
        "scenario": _without_folders(msgspec.to_builtins(scenario)) | {"description": "", "max_work": MAX_WORK},
        "labels": dict(labels),
        "inputs": {name: _sha256(path) for name, path in input_files(scenario).items()},
        "versions": {name: version(name) for name in PACKAGES},
    }
    return hashlib.sha256(msgspec.json.encode(facts, order="sorted")).hexdigest()


def _without_folders(content: dict[str, Any]) -> dict[str, Any]:
    """A scenario that names its files without their folders; what counts is their content."""
    policy = _policy_without_folders(content["policy"])
    shares = {
        name: {**part, "policy": _policy_without_folders(part["policy"])} for name, part in content["shares"].items()
    }
    background = {
        name: Path(value).name if name == "recording" else value for name, value in content["background"].items()
    }
    found = {**content, "net": Path(content["net"]).name, "policy": policy, "background": background, "shares": shares}
    return {name: value for name, value in found.items() if name not in NEWER or value not in (None, {})}


def _policy_without_folders(policy: dict[str, Any]) -> dict[str, Any]:
    return {name: Path(value).name if name in ("checkpoint", "object") else value for name, value in policy.items()}


_sha256 = cache(sha256)


@contextmanager
def _naming_field(path: Path, where: Sequence[str]) -> Iterator[None]:
    """Add the field of the batch file to input errors."""
    try:
        yield
    except InputError as error:
        raise located(path, where, str(error)) from None


@dataclass(frozen=True)
class _KnownNames:
    """The names that are allowed in each field of a cell."""

    scenarios: dict[str, Scenario]
    policies: tuple[str, ...]
    perturbations: tuple[str, ...]
    variants: tuple[str, ...]

    @classmethod
    def of(cls, batch: Batch, path: Path, max_work: float | None) -> "_KnownNames":
        scenarios = {}
        for k, name in enumerate(batch.scenarios):
            where = ("scenarios", f"[{k}]")
            label = Path(name).name.removesuffix(".yaml")
            if label in scenarios:
                raise located(path, where, f"two scenarios have the name {label!r}; remove one, or rename its file")
            with _naming_field(path, where):
                own = load_scenario(name, beside=path, max_work=max_work)
                scenarios[label] = msgspec.structs.replace(own, surroundings=False)  # large; `overrides` can turn it on
        nominal = (NOMINAL,) if batch.nominal else ()
        return cls(
            scenarios, tuple(batch.policies), (*nominal, *batch.perturbations), tuple(batch.variants) or (PLAIN,)
        )

    def cell(self, extra: ExtraRun, path: Path, where: Sequence[str]) -> Cell:
        """The cell of an extra run."""
        self.check(extra, path, where)
        if (extra.perturbation in (None, NOMINAL)) != (extra.intensity is None):
            raise located(path, where, "a perturbation and its intensity belong together; give both or neither")
        own = self.scenarios[extra.scenario]
        return Cell(
            extra.scenario,
            extra.policy or policy_name(own.policy),
            extra.perturbation or NOMINAL,
            extra.intensity,
            extra.variant or PLAIN,
            own.seed if extra.seed is None else extra.seed,
        )

    def check(self, cell: Any, path: Path, where: Sequence[str]) -> None:
        """Raise `InputError` for a name that is not in the batch file."""
        own = tuple(policy_name(scenario.policy) for scenario in self.scenarios.values())
        for field, known in (
            ("scenario", tuple(self.scenarios)),
            ("policy", self.policies or own),
            ("perturbation", (*self.perturbations, NOMINAL)),
            ("variant", (*self.variants, PLAIN)),
        ):
            value = getattr(cell, field)
            if value is not None and value not in known:
                close = difflib.get_close_matches(value, known, n=1)
                hint = f"did you mean {close[0]!r}?" if close else f"expected one of {', '.join(dict.fromkeys(known))}"
                raise located(path, (*where, field), f"unknown {field} {value!r}; {hint}")


class _Matrix:
    """The cells of the matrix, and the scenario of each; runs that differ only in their seed share one check."""

    def __init__(self, batch: Batch, path: Path, names: _KnownNames) -> None:
        self._batch, self._path, self._names = batch, path, names
        self._built: dict[tuple[Any, ...], Scenario] = {}

    def cells(self) -> Iterator[Cell]:
        perturbed = [(name, k) for name in self._names.perturbations for k in self._intensities(name)]
        for scenario, own in self._names.scenarios.items():
            policies = self._names.policies or (policy_name(own.policy),)
            seeds = self._batch.seed_list() or (own.seed,)
            for policy, (name, intensity), variant, seed in product(policies, perturbed, self._names.variants, seeds):
                yield Cell(scenario, policy, name, intensity, variant, seed)

    def _intensities(self, name: str) -> Iterable[float | None]:
        return (None,) if name == NOMINAL else self._batch.perturbations[name].intensities

    def run(self, cell: Cell) -> Run:
        shared = (cell.scenario, cell.policy, cell.perturbation, cell.intensity, cell.variant)
        if shared not in self._built:
            self._built[shared] = self._scenario(cell)
        scenario = msgspec.structs.replace(self._built[shared], seed=cell.seed)
        with _naming_field(
            self._path, ("policies", cell.policy) if cell.policy in self._batch.policies else ("scenarios",)
        ):
            return Run(cell, scenario, key_of(scenario, msgspec.to_builtins(cell)))

    def _scenario(self, cell: Cell) -> Scenario:
        batch = self._batch
        content = msgspec.to_builtins(self._names.scenarios[cell.scenario])
        for where, changes in (
            (("overrides",), batch.overrides),
            (("variants", cell.variant), batch.variants.get(cell.variant, {})),
        ):
            content = self._overlaid(content, changes, where)
        if cell.policy in batch.policies:
            content["policy"] = msgspec.to_builtins(batch.policies[cell.policy])
        if cell.perturbation in batch.perturbations:
            sweep = batch.perturbations[cell.perturbation]
            block = {"kind": sweep.kind, "intensity": cell.intensity, **sweep.settings}
            content["perturbations"] = [*content.get("perturbations", ()), block]
        where = ("perturbations", cell.perturbation) if cell.intensity is not None else ("policies", cell.policy)
        return checked(content, Scenario, self._path, under=where)

    def _overlaid(self, content: dict[str, Any], changes: dict[str, Any], where: tuple[str, ...]) -> dict[str, Any]:
        if isinstance(changes.get("traffic"), str):
            with _naming_field(self._path, (*where, "traffic")):
                changes = {**changes, "traffic": traffic_content(changes["traffic"], beside=self._path)}
        content = overlay(content, changes)
        checked(content, Scenario, self._path, under=where)
        return content


def _exclusions(batch: Batch, path: Path, names: _KnownNames) -> list[dict[str, Any]]:
    """The given fields of each exclusion, checked."""
    exclusions = []
    for k, exclusion in enumerate(batch.exclude):
        where = ("exclude", f"[{k}]")
        names.check(exclusion, path, where)
        given = {field: value for field, value in msgspec.structs.asdict(exclusion).items() if value is not None}
        if not given:
            raise located(path, where, "names no field, so it would exclude every run; remove it")
        exclusions.append(given)
    return exclusions


def _matches(cell: Cell, given: Mapping[str, Any]) -> bool:
    return all(getattr(cell, field) == value for field, value in given.items())
