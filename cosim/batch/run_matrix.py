"""From a batch file to the list of its runs: single, checked scenarios with a label and a content hash each."""

import difflib
import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any

import msgspec

from cosim.batch.spec import NOMINAL, PLAIN, Addition, Batch, Sweep
from cosim.spec.input_files import input_files, sha256
from cosim.spec.loading import find, load_scenario, traffic_of
from cosim.spec.scenario import Driver, Scenario, tag_of
from gri.config import checked, located, parsed, typed
from gri.errors import InputError

FORMAT = 1  # of what runs write; a new number runs every batch again
PACKAGES = ("gri-cosim", "libsumo", "numpy", "torch")  # whose versions a run depends on
TAGS = ("kind", "rule", "source")  # a mapping with one of these replaces another one as a whole


@dataclass(frozen=True, order=True)
class Cell:
    """Where a run stands in the matrix; `intensity` is None for a nominal run."""

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
    """One run of a batch. `key` is the hash of all that its results depend on."""

    cell: Cell
    scenario: Scenario
    key: str

    @property
    def id(self) -> str:
        """A letter (so that no reader takes it for a number) and the key's first eleven digits: names its folder."""
        return f"r{self.key[:11]}"


def load_batch(name: str) -> tuple[Batch, Path]:
    """The batch of that name (shipped in `scenarios/batch/`) or path, and its file."""
    path = find(name, "scenarios/batch", "batch")
    content = parsed(path)
    if isinstance(content, dict):
        for field, kind in (("policies", Driver), ("perturbations", Sweep), ("variants", dict)):
            entries = content.get(field)
            for key, entry in entries.items() if isinstance(entries, dict) else ():
                checked(entry, kind, path, under=(field, str(key)))  # msgspec does not name the keys of mappings
    return typed(content, Batch, path), path


def expand(batch: Batch, path: Path) -> tuple[Run, ...]:
    """Every run of a batch, in the order of its file; an InputError names the field that does not fit."""
    names = _Names.of(batch, path)
    matrix = _Matrix(batch, path, names)
    exclusions = _exclusions(batch, path, names)
    cells = {cell: None for cell in matrix.cells() if not any(matches(cell) for matches in exclusions)}
    for k, addition in enumerate(batch.include):
        cell = names.cell(addition, path, ("include", f"[{k}]"))
        if cell in cells:
            raise located(path, ("include", f"[{k}]"), f"the matrix has this run already ({cell}); remove it")
        cells[cell] = None
    if not cells:
        raise located(path, ("exclude",), "nothing is left to run; exclude less")
    return tuple(matrix.run(cell) for cell in cells)


def key_of(scenario: Scenario, labels: Mapping[str, Any]) -> str:
    """SHA-256 of all that a run's results depend on: scenario, the files it names, labels and versions."""
    facts = {
        "format": FORMAT,
        "scenario": msgspec.to_builtins(msgspec.structs.replace(scenario, description="")),
        "labels": dict(labels),
        "inputs": {name: _sha256(path) for name, path in input_files(scenario).items()},
        "versions": {name: version(name) for name in PACKAGES},
    }
    return hashlib.sha256(msgspec.json.encode(facts, order="sorted")).hexdigest()


_sha256 = cache(sha256)


@contextmanager
def _at(path: Path, where: Sequence[str]) -> Iterator[None]:
    """Let input errors name the field of the batch file that led to them."""
    try:
        yield
    except InputError as error:
        raise located(path, where, str(error)) from None


@dataclass(frozen=True)
class _Names:
    """What can stand in each field of a cell; `default` is what an addition leaves out."""

    scenarios: dict[str, Scenario]
    policies: tuple[str, ...]
    perturbations: tuple[str, ...]
    variants: tuple[str, ...]

    @classmethod
    def of(cls, batch: Batch, path: Path) -> "_Names":
        scenarios = {}
        for k, name in enumerate(batch.scenarios):
            where = ("scenarios", f"[{k}]")
            label = Path(name).name.removesuffix(".yaml")
            if label in scenarios:
                raise located(path, where, f"a second scenario called {label!r}; keep one or rename its file")
            with _at(path, where):
                scenarios[label] = load_scenario(name, beside=path)
        nominal = (NOMINAL,) if batch.nominal else ()
        return cls(
            scenarios, tuple(batch.policies), (*nominal, *batch.perturbations), tuple(batch.variants) or (PLAIN,)
        )

    def cell(self, addition: Addition, path: Path, where: Sequence[str]) -> Cell:
        """The cell an addition means."""
        self.check(addition, path, where)
        if (addition.perturbation in (None, NOMINAL)) != (addition.intensity is None):
            raise located(path, where, "a perturbation and its intensity belong together; give both or neither")
        own = self.scenarios[addition.scenario]
        return Cell(
            addition.scenario,
            addition.policy or tag_of(own.policy),
            addition.perturbation or NOMINAL,
            addition.intensity,
            addition.variant or PLAIN,
            own.seed if addition.seed is None else addition.seed,
        )

    def check(self, cell: Any, path: Path, where: Sequence[str]) -> None:
        """Refuse names that the matrix does not know."""
        own = tuple(tag_of(scenario.policy) for scenario in self.scenarios.values())
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
    """Builds cells, and the scenario of each; what several runs share is checked once."""

    def __init__(self, batch: Batch, path: Path, names: _Names) -> None:
        self._batch, self._path, self._names = batch, path, names
        self._built: dict[tuple[Any, ...], Scenario] = {}

    def cells(self) -> Iterator[Cell]:
        grades = [(name, k) for name in self._names.perturbations for k in self._intensities(name)]
        for scenario, own in self._names.scenarios.items():
            policies = self._names.policies or (tag_of(own.policy),)
            seeds = self._batch.seed_list() or (own.seed,)
            for policy, (name, intensity), variant, seed in product(policies, grades, self._names.variants, seeds):
                yield Cell(scenario, policy, name, intensity, variant, seed)

    def _intensities(self, name: str) -> Iterable[float | None]:
        return (None,) if name == NOMINAL else self._batch.perturbations[name].intensities

    def run(self, cell: Cell) -> Run:
        shared = (cell.scenario, cell.policy, cell.perturbation, cell.intensity, cell.variant)
        if shared not in self._built:
            self._built[shared] = self._scenario(cell)
        scenario = msgspec.structs.replace(self._built[shared], seed=cell.seed)
        with _at(self._path, ("policies", cell.policy) if cell.policy in self._batch.policies else ("scenarios",)):
            return Run(cell, scenario, key_of(scenario, msgspec.to_builtins(cell)))

    def _scenario(self, cell: Cell) -> Scenario:
        batch = self._batch
        content = msgspec.to_builtins(self._names.scenarios[cell.scenario])
        for where, changes in (
            (("overrides",), batch.overrides),
            (("variants", cell.variant), batch.variants.get(cell.variant, {})),
        ):
            content = self._changed(content, changes, where)
        if cell.policy in batch.policies:
            content["policy"] = msgspec.to_builtins(batch.policies[cell.policy])
        if cell.perturbation in batch.perturbations:
            sweep = batch.perturbations[cell.perturbation]
            block = {"kind": sweep.kind, "intensity": cell.intensity, **sweep.settings}
            content["perturbations"] = [*content.get("perturbations", ()), block]
        where = ("perturbations", cell.perturbation) if cell.intensity is not None else ("policies", cell.policy)
        return checked(content, Scenario, self._path, under=where)

    def _changed(self, content: dict[str, Any], changes: dict[str, Any], where: tuple[str, ...]) -> dict[str, Any]:
        if isinstance(changes.get("traffic"), str):
            with _at(self._path, (*where, "traffic")):
                changes = {**changes, "traffic": traffic_of(changes["traffic"], beside=self._path)}
        content = _merged(content, changes)
        checked(content, Scenario, self._path, under=where)
        return content


def _merged(content: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Content with changes laid over it: mappings field by field, everything else as a whole."""
    result = dict(content)
    for name, value in changes.items():
        old = result.get(name)
        if isinstance(old, dict) and isinstance(value, dict) and not any(tag in value for tag in TAGS):
            value = _merged(old, value)
        result[name] = value
    return result


def _exclusions(batch: Batch, path: Path, names: _Names) -> list[Callable[[Cell], bool]]:
    """A test per exclusion: whether it matches a cell."""
    tests = []
    for k, exclusion in enumerate(batch.exclude):
        where = ("exclude", f"[{k}]")
        names.check(exclusion, path, where)
        given = {field: value for field, value in msgspec.structs.asdict(exclusion).items() if value is not None}
        if not given:
            raise located(path, where, "names no field and would leave out everything; remove it")
        tests.append(partial(_agrees, given))
    return tests


def _agrees(given: Mapping[str, Any], cell: Cell) -> bool:
    return all(getattr(cell, field) == value for field, value in given.items())
