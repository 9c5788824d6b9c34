"""A data set of scenes from many seeds: one simulation per seed, and one file in the end.

The file of a seed depends on its spec only, and the data set takes as many seeds as it needs, in order. So the file
does not depend on the number of workers, nor on where a run was stopped and continued.
"""

import hashlib
import os
import shutil
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec

from cosim.process.task import Task, TaskResult
from cosim.process.task_pool import run_local
from cosim.scenes.scene_rules import DT, Kind, Rules
from cosim.scenes.seed_scenes import SPLITS, SeedSpec
from cosim.scenes.seed_task import FIGURES, SCENES, SeedResult
from cosim.spec.input_files import find_net, sha256
from cosim.spec.loading import override
from cosim.spec.scenario import Scenario
from gri.data.scene_file.schema import Header, joining
from gri.errors import InputError, guarded_reading
from gri.storage.verification import check_digest, digest, read_sealed, write_digest, write_sealed
from gri.storage.whole_files import part_beside, publish, remove

FILE, SEEDS = "scenes.parquet", "seeds"
FIX = "give the same command again, which simulates this seed once more"
SEED_TIME_LIMIT = 24 * 3600.0  # [s] of wall-clock time
MAX_EMPTY_SEEDS = 10  # seeds without any scene of a kind after which the data set is given up
Tell = Callable[[int, int], None]  # (scenes so far, wanted)
Warn = Callable[[str], None]


class DatasetSpec(msgspec.Struct, frozen=True, kw_only=True):
    """What a data set holds: `count` scenes of each kind, at most `per_seed` of them from one seed.

    Seeds are counted from the scenario's own seed on.
    """

    scenario: Scenario
    source: str
    kinds: tuple[Kind, ...]
    count: int
    per_seed: int
    gold: bool
    rules: Rules

    @property
    def total(self) -> int:
        return self.count * len(self.kinds)

    def spec(self, k: int) -> SeedSpec:
        """The k-th seed's share."""
        return SeedSpec(
            scenario=override(self.scenario, {"seed": self.scenario.seed + k}),
            source=self.source,
            split=SPLITS[k % len(SPLITS)],
            kinds=self.kinds,
            count=self.per_seed,
            gold=self.gold,
            rules=self.rules,
        )

    def header(self, seeds: int) -> Header:
        """The metadata of the file: time step, vehicles and provenance."""
        flows = {str(k): flow.name for k, flow in enumerate(self.scenario.traffic.flows)}
        return Header(
            dt=DT,
            vehicles=self.scenario.group.size,
            provenance={
                "made by": f"gri-cosim {version('gri-cosim')}, SUMO {version('libsumo')}",
                "sumo": msgspec.to_builtins(self) | {
                    "net_sha256": sha256(find_net(self.scenario.net)),
                    "scenario_sha256": hashlib.sha256(msgspec.json.encode(self.scenario)).hexdigest(),
                    "seeds": [self.scenario.seed, self.scenario.seed + seeds - 1],
                    "vehicle numbers": {"flow k, vehicle n": "1000000 k + n", "flows": flows},
                },
            },
        )  # fmt: skip


@dataclass(frozen=True)
class Dataset:
    """A finished data set: its file, the results of its seeds, and the number of scenes made in this run."""

    path: Path
    seeds: tuple[SeedResult, ...]
    new_scenes: int


def make(order: DatasetSpec, folder: Path, workers: int, tell: Tell, warn: Warn = lambda text: None) -> Dataset:
    """Simulate seeds until there are enough scenes of every kind, then join them; finished seeds are reused.

    Nobody else may use the folder meanwhile. The data set is finished when `remove_seeds` has been called.

    `tell` is called with the scenes so far and the scenes wanted. `warn` is called with a sentence about each finished
    seed that is damaged and simulated again, and each seed that had no scene of a kind; it says which rule turned down
    how many candidates. Raises `InputError` if the folder has a data set already, or if no scene of a kind is found.
    """
    store = SeedStore(order, folder, warn)
    before = store.scenes()
    tell(before, order.total)
    while (enough := store.enough()) is None:
        queue: deque[Task] = deque()
        _refill(queue, store, workers)
        with closing(run_local(queue, SEED_TIME_LIMIT, workers=workers)) as answers:
            for answer in answers:
                store.keep(answer)
                for text in store.empty_handed(int(answer.name)):
                    warn(text)
                tell(store.scenes(), order.total)
                if store.enough() is None:
                    _refill(queue, store, 1)
    return Dataset(store.join(enough), tuple(store.results[k] for k in range(enough)), store.scenes() - before)


def remove_seeds(folder: Path) -> None:
    """Remove the files of the seeds of a data set whose file and report are written."""
    aside = part_beside(folder / SEEDS)
    (folder / SEEDS).rename(aside)  # at once, so that a killed command leaves all of them or none
    remove(aside)


def _refill(queue: deque[Task], store: "SeedStore", count: int) -> None:
    queue.extend(store.task() for _ in range(count))


class SeedStore:
    """The seeds in a folder: which ones are finished, which ones are running, and whether there are enough."""

    def __init__(self, order: DatasetSpec, folder: Path, warn: Warn = lambda text: None) -> None:
        self.order, self.folder, self._seeds = order, folder, folder / SEEDS
        if (folder / FILE).exists() and not self._seeds.exists():
            raise InputError(f"{folder / FILE}: exists already; give another --out, or remove it")
        self._seeds.mkdir(parents=True, exist_ok=True)
        net = sha256(find_net(order.scenario.net))
        self._salt = [net, version("gri-cosim"), version("libsumo")]
        self.results: dict[int, SeedResult] = {}
        for path in sorted(self._seeds.iterdir()):
            try:
                found = self._read(path)
            except InputError as error:
                warn(f"{str(error).partition(';')[0]}; this seed is simulated again")
                found = None
            if found is None:
                remove(path)
            else:
                self.results[int(path.name)] = found
        self._started = set(self.results)

    def _key(self, k: int) -> str:
        return hashlib.sha256(msgspec.json.encode([self.order.spec(k), self._salt])).hexdigest()

    def _read(self, path: Path) -> SeedResult | None:
        """The result of a finished seed; None if the folder is incomplete or belongs to another data set.

        Errors: `DamagedError` if its files are not what was written.
        """
        if not path.name.isdigit() or not (path / FIGURES).is_file():
            return None
        content = read_sealed(path / FIGURES, FIX)
        if content.get("key") != self._key(int(path.name)):
            return None
        with guarded_reading(path / FIGURES, "result of a seed", FIX):
            result = msgspec.convert(content, SeedResult)
        check_digest(path / SCENES, result.sha256, FIX)
        return result

    def task(self) -> Task:
        """The next seed that is neither finished nor running."""
        k = next(k for k in range(len(self._started) + 1) if k not in self._started)
        self._started.add(k)
        folder = self._seeds / f".{k}.{os.getpid()}"
        return Task(str(k), "cosim.scenes.seed_task:seed_task", (self.order.spec(k),), folder)

    def keep(self, answer: TaskResult) -> None:
        """Add the result of a worker. Raises `InputError` or RuntimeError with the reason if the worker failed."""
        k = int(answer.name)
        if answer.kind != "done":
            shutil.rmtree(answer.folder, ignore_errors=True)
            message = f"seed {self.order.scenario.seed + k}: {answer.message}"
            raise InputError(message) if answer.kind == "input" else RuntimeError(message)
        seconds = round(answer.cpu_seconds, 3)
        try:
            result = SeedResult(
                key=self._key(k),
                sha256=digest(answer.folder / SCENES),
                figures=answer.value,
                cpu_seconds=seconds,
                peak_mb=answer.peak_mb,
            )
            write_sealed(answer.folder / FIGURES, msgspec.to_builtins(result))
            publish(answer.folder, self._seeds / answer.name)
        except OSError as error:
            shutil.rmtree(answer.folder, ignore_errors=True)
            raise RuntimeError(
                f"seed {self.order.scenario.seed + k}: its result cannot be stored: {error.strerror}"
            ) from error
        self.results[k] = result
        if len(self.results) >= MAX_EMPTY_SEEDS:
            self._check_kinds()

    def _check_kinds(self) -> None:
        for kind in self.order.kinds:
            if not any(_scenes(result, kind) for result in self.results.values()):
                raise InputError(
                    f"{self.order.source}: no {kind} scene in {len(self.results)} seeds;"
                    f" {_turned_down(list(self.results.values()), kind)};"
                    " relax the rules (see `cosim scenes --help`)"
                )

    def empty_handed(self, k: int) -> list[str]:
        """A sentence for each kind of which the k-th seed had no scene."""
        return [
            f"seed {self.order.scenario.seed + k}: no {kind} scene; {_turned_down([self.results[k]], kind)}"
            for kind in self.order.kinds
            if not _scenes(self.results[k], kind)
        ]

    def scenes(self) -> int:
        """Number of scenes so far; of each kind at most as many as wanted."""
        return sum(
            min(sum(_scenes(result, kind) for result in self.results.values()), self.order.count)
            for kind in self.order.kinds
        )

    def enough(self) -> int | None:
        """Number of seeds, counted from the first one without a gap, that suffice; None if there are not enough yet."""
        left: dict[Kind, int] = dict.fromkeys(self.order.kinds, self.order.count)
        k = 0
        while max(left.values()) > 0:
            if k not in self.results:
                return None
            left = {kind: count - _scenes(self.results[k], kind) for kind, count in left.items()}
            k += 1
        return k

    def join(self, seeds: int) -> Path:
        """Write the file of the data set from the first `seeds` seeds, and its hash beside it."""
        left: dict[str, int] = dict.fromkeys(self.order.kinds, self.order.count)
        with joining(self.folder / FILE, self.order.header(seeds)) as append:
            for k in range(seeds):
                append(check_digest(self._seeds / str(k) / SCENES, self.results[k].sha256, FIX), left)
                left = {kind: max(left[kind] - _scenes(self.results[k], kind), 0) for kind in self.order.kinds}
        write_digest(self.folder / FILE)
        return self.folder / FILE


def _scenes(result: SeedResult, kind: Kind) -> int:
    return int(result.figures.tallies[kind]["scenes"])


def _turned_down(seeds: Sequence[SeedResult], kind: Kind) -> str:
    """Which rule turned down how many candidates, the greatest number first."""
    rejected = total_tally(seeds, kind)["rejected"]
    if not rejected:
        return "there was no candidate"
    reasons = sorted(rejected.items(), key=lambda item: -item[1])
    return f"turned down {sum(rejected.values())}: " + ", ".join(f"{count} {reason}" for reason, count in reasons)


def total_tally(seeds: Sequence[SeedResult], kind: Kind) -> dict[str, Any]:
    """The tallies of all seeds of a kind, added up."""
    found: dict[str, Any] = {}
    for result in seeds:
        found = _sum(found, result.figures.tallies[kind]) if found else dict(result.figures.tallies[kind])
    return found


def _sum(one: Any, other: Any) -> Any:
    if isinstance(one, dict):
        names = sorted({*one, *other})
        return {name: _sum(one.get(name, 0), other[name]) if name in other else one[name] for name in names}
    if isinstance(one, list):
        return [_sum(a, b) for a, b in zip(one, other, strict=True)]
    return one + other
