"""A data set out of many seeds: who films which, what is kept when, and the one file in the end.

Every seed's file depends on its spec alone, and the data set takes seeds in order, as many as it needs. So neither the
number of workers nor where a run was stopped shows in the file.
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

from cosim.process.task import Answer, Task
from cosim.process.task_pool import run_local
from cosim.scenes.rules import DT, Kind, Rules
from cosim.scenes.seed_scenes import SPLITS, Spec
from cosim.scenes.seed_task import FIGURES, SCENES, SeedResult
from cosim.spec.input_files import find_net, sha256
from cosim.spec.loading import override
from cosim.spec.scenario import Scenario
from gri.data.scene_file.schema import Header, joining
from gri.errors import InputError

FILE = "scenes.parquet"
LONGEST = 24 * 3600.0  # [s] that a seed may take
PATIENCE = 10  # seeds without a single scene of a kind before giving up
Tell = Callable[[int, int], None]  # (scenes so far, wanted)


class Order(msgspec.Struct, frozen=True, kw_only=True):
    """What is wanted: so many scenes of each kind, of seeds from the scenario's on, so many of each at most."""

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

    def spec(self, k: int) -> Spec:
        """The k-th seed's share."""
        return Spec(
            scenario=override(self.scenario, {"seed": self.scenario.seed + k}),
            source=self.source,
            split=SPLITS[k % len(SPLITS)],
            kinds=self.kinds,
            count=self.per_seed,
            gold=self.gold,
            rules=self.rules,
        )

    def header(self, seeds: int) -> Header:
        """What the file says of itself."""
        flows = {str(k): flow.name for k, flow in enumerate(self.scenario.traffic.flows)}
        return Header(
            dt=DT,
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
class Made:
    """The file, the seeds it is made of, and how many scenes this run had to make."""

    path: Path
    brought: tuple[SeedResult, ...]
    fresh: int


def make(order: Order, folder: Path, workers: int, tell: Tell) -> Made:
    """Film seeds until there are enough scenes of every kind, and join them; what is there already is kept."""
    store = Store(order, folder)
    before = store.scenes()
    tell(before, order.total)
    while (enough := store.enough()) is None:
        queue: deque[Task] = deque()
        _refill(queue, store, workers)
        with closing(run_local(queue, LONGEST, workers=workers)) as answers:
            for answer in answers:
                store.keep(answer)
                tell(store.scenes(), order.total)
                if store.enough() is None:
                    _refill(queue, store, 1)
    return Made(store.join(enough), tuple(store.brought[k] for k in range(enough)), store.scenes() - before)


def _refill(queue: deque[Task], store: "Store", count: int) -> None:
    queue.extend(store.task() for _ in range(count))


class Store:
    """The seeds in a folder: which are there, which are under way, and whether they are enough."""

    def __init__(self, order: Order, folder: Path) -> None:
        self.order, self.folder, self._seeds = order, folder, folder / "seeds"
        if (folder / FILE).exists():
            raise InputError(f"{folder / FILE}: is there already; give another --out, or remove it")
        self._seeds.mkdir(parents=True, exist_ok=True)
        net = sha256(find_net(order.scenario.net))
        self._salt = [net, version("gri-cosim"), version("libsumo")]
        self.brought: dict[int, SeedResult] = {}
        for path in self._seeds.iterdir():
            found = self._found(path)
            if found is None:
                shutil.rmtree(path)
            else:
                self.brought[int(path.name)] = found
        self._asked = set(self.brought)

    def _key(self, k: int) -> str:
        return hashlib.sha256(msgspec.json.encode([self.order.spec(k), self._salt])).hexdigest()

    def _found(self, path: Path) -> SeedResult | None:
        if not path.name.isdigit() or not (path / FIGURES).is_file():
            return None
        brought = msgspec.json.decode((path / FIGURES).read_bytes(), type=SeedResult)
        return brought if brought.key == self._key(int(path.name)) else None

    def task(self) -> Task:
        """The next seed that is neither there nor under way."""
        k = next(k for k in range(len(self._asked) + 1) if k not in self._asked)
        self._asked.add(k)
        folder = self._seeds / f".{k}.{os.getpid()}"
        return Task(str(k), "cosim.scenes.seed_task:seed_task", (self.order.spec(k),), folder)

    def keep(self, answer: Answer) -> None:
        """Put what a worker made on the store. Errors: `InputError` or RuntimeError with what went wrong."""
        k = int(answer.name)
        if answer.kind != "done":
            shutil.rmtree(answer.folder, ignore_errors=True)
            message = f"seed {self.order.scenario.seed + k}: {answer.message}"
            raise InputError(message) if answer.kind == "input" else RuntimeError(message)
        seconds = round(answer.cpu_seconds, 3)
        brought = SeedResult(key=self._key(k), figures=answer.value, cpu_seconds=seconds, peak_mb=answer.peak_mb)
        try:
            (answer.folder / FIGURES).write_bytes(msgspec.json.encode(brought))
            os.replace(answer.folder, self._seeds / answer.name)
        except OSError as error:
            shutil.rmtree(answer.folder, ignore_errors=True)
            raise RuntimeError(f"seed {self.order.scenario.seed + k}: cannot be kept: {error.strerror}") from error
        self.brought[k] = brought
        if len(self.brought) >= PATIENCE:
            self._check_kinds()

    def _check_kinds(self) -> None:
        for kind in self.order.kinds:
            if not any(_scenes(brought, kind) for brought in self.brought.values()):
                raise InputError(
                    f"{self.order.source}: no {kind} scene in {len(self.brought)} seeds; look at the rules"
                )

    def scenes(self) -> int:
        """How many scenes there are, of each kind no more than wanted."""
        return sum(
            min(sum(_scenes(brought, kind) for brought in self.brought.values()), self.order.count)
            for kind in self.order.kinds
        )

    def enough(self) -> int | None:
        """How many seeds, from the first one on without a gap, are enough; None where they are not."""
        left: dict[Kind, int] = dict.fromkeys(self.order.kinds, self.order.count)
        k = 0
        while max(left.values()) > 0:
            if k not in self.brought:
                return None
            left = {kind: count - _scenes(self.brought[k], kind) for kind, count in left.items()}
            k += 1
        return k

    def join(self, seeds: int) -> Path:
        """Write the one file and remove the seeds' own."""
        left: dict[str, int] = dict.fromkeys(self.order.kinds, self.order.count)
        with joining(self.folder / FILE, self.order.header(seeds)) as append:
            for k in range(seeds):
                append(self._seeds / str(k) / SCENES, left)
                left = {kind: max(left[kind] - _scenes(self.brought[k], kind), 0) for kind in self.order.kinds}
        shutil.rmtree(self._seeds)
        return self.folder / FILE


def _scenes(brought: SeedResult, kind: Kind) -> int:
    return int(brought.figures.tallies[kind]["scenes"])


def totals(made: Sequence[SeedResult], kind: Kind) -> dict[str, Any]:
    """The tallies of all seeds of a kind in one: counts and tables added up."""
    found: dict[str, Any] = {}
    for brought in made:
        found = _sum(found, brought.figures.tallies[kind]) if found else dict(brought.figures.tallies[kind])
    return found


def _sum(one: Any, other: Any) -> Any:
    if isinstance(one, dict):
        names = sorted({*one, *other})
        return {name: _sum(one.get(name, 0), other[name]) if name in other else one[name] for name in names}
    if isinstance(one, list):
        return [_sum(a, b) for a, b in zip(one, other, strict=True)]
    return one + other
