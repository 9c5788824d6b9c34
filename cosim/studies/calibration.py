"""Finding drivers and a bottleneck with which the traffic of a scenario reaches its recorded targets.

Minimised is the mean over seeds and targets of (relative error / tolerance)²: below 1 all targets are reached on
average. A simulation is dear, noisy and has no derivatives, so the optimiser is COBYQA (Ragonneau 2022, in scipy): it
fits quadratic models to few evaluations inside bounds. It is deterministic and every evaluation is kept, so that the
same call goes on where it was stopped.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import reduce
from multiprocessing import get_context
from pathlib import Path

import msgspec
import numpy as np
import yaml
from jaxtyping import Float
from msgspec.structs import replace
from scipy.optimize import minimize

from cosim.runs.run_job import survey_job
from cosim.spec.demand import Traffic
from cosim.spec.scenario import Scenario
from cosim.studies.traffic_targets import Figures, checks, figures_of
from gri.errors import InputError

REACH = 0.25  # how far a parameter may go from its start, relative
FIRST_STEP, LAST_STEP = 0.04, 0.005  # trust-region radii, relative to the start
COLLISION = 100.0  # what a collision or teleport adds to the misfit

Tell = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Parameter:
    """A free number of a traffic description: `tau`, `limit` (all limits by one factor) or `limit.K` (the K-th)."""

    name: str

    @property
    def interval(self) -> int | None:
        """Of which demand interval (0-based) this is the limit; None for all."""
        number = self.name.partition(".")[2]
        return int(number) - 1 if number else None

    def of(self, traffic: Traffic) -> float:
        """Its value; that of the first class or limit where it scales all of them."""
        if self.name == "tau":
            return traffic.vehicles[0].tau
        assert traffic.bottleneck is not None, "checked by `parameters`"
        return traffic.bottleneck.limits[self.interval or 0]

    def put(self, traffic: Traffic, value: float) -> Traffic:
        """The traffic with that value."""
        factor = value / self.of(traffic)
        if self.name == "tau":
            vehicles = tuple(replace(v, tau=round(v.tau * factor, 4)) for v in traffic.vehicles)
            return replace(traffic, vehicles=vehicles)
        assert traffic.bottleneck is not None, "checked by `parameters`"
        limits = tuple(
            round(limit * factor, 3) if self.interval in (None, k) else limit
            for k, limit in enumerate(traffic.bottleneck.limits)
        )
        return replace(traffic, bottleneck=replace(traffic.bottleneck, limits=limits))


def parameters(names: Sequence[str], traffic: Traffic) -> tuple[Parameter, ...]:
    """The named parameters, checked against the traffic."""
    intervals = len(traffic.bottleneck.limits) if traffic.bottleneck else 0
    known = ["tau", *(["limit"] if intervals else []), *(f"limit.{k + 1}" for k in range(intervals))]
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"--free: got {unknown[0]!r}, this traffic has {', '.join(known)}")
    return tuple(Parameter(name) for name in names)


@dataclass(frozen=True)
class Evaluation:
    """One trial: the values, what each seed gave, and the misfit."""

    values: tuple[float, ...]
    misfit: float
    runs: tuple[Figures, ...]


@dataclass(frozen=True)
class Search:
    """A calibration and its folder: `evaluations.jsonl` holds what was tried, `traffic.yaml` the best."""

    scenario: Scenario
    free: tuple[Parameter, ...]
    seeds: tuple[int, ...]
    duration: float
    folder: Path

    def traffic(self, values: Sequence[float]) -> Traffic:
        pairs = zip(self.free, values, strict=True)
        return reduce(lambda traffic, pair: pair[0].put(traffic, pair[1]), pairs, self.scenario.traffic)

    @property
    def problem(self) -> str:
        """What all evaluations of the folder have in common."""
        content = (self.scenario, [p.name for p in self.free], self.seeds, self.duration)
        return hashlib.sha256(msgspec.json.encode(content)).hexdigest()

    @property
    def log(self) -> Path:
        return self.folder / "evaluations.jsonl"


def calibrate(search: Search, evaluations: int, workers: int, tell: Tell) -> Evaluation:
    """Try up to so many settings in all, those already tried included; write and return the best.

    Raises InputError where the scenario has no targets, or the folder belongs to another problem.
    """
    if search.scenario.traffic.targets is None:
        raise InputError("traffic.targets: this scenario's traffic has none; state what is to be reached")
    search.folder.mkdir(parents=True, exist_ok=True)
    known = {found.values: found for found in _read(search)}
    start = np.array([parameter.of(search.scenario.traffic) for parameter in search.free])
    asked: list[tuple[float, ...]] = []
    with _executor(workers) as executor:

        def misfit(scaled: Float[np.ndarray, " P"]) -> float:
            values = tuple(float(value) for value in np.round(start * scaled, 3))
            if values not in asked:
                tell("evaluations", len(asked), evaluations)
                asked.append(values)
            if values not in known:
                known[values] = _evaluate(search, values, executor)
                _write(search, known[values])
            return known[values].misfit

        options = {"maxfev": evaluations, "initial_tr_radius": FIRST_STEP, "final_tr_radius": LAST_STEP}
        bounds = [(1 - REACH, 1 + REACH)] * len(start)
        minimize(misfit, np.ones(len(start)), method="COBYQA", bounds=bounds, options=options)
    tell("evaluations", evaluations, evaluations)
    best = min(known.values(), key=lambda found: found.misfit)
    _write_traffic(search, best, len(known))
    return best


def misfit_of(scenario: Scenario, runs: Sequence[Figures]) -> float:
    """Mean over seeds and targets of (relative error / tolerance)²; collisions and teleports count extra."""
    targets = scenario.traffic.targets
    assert targets is not None, "checked by `calibrate`"
    errors = [check.error / check.tolerance for run in runs for check in checks(targets, run)]
    return float(np.mean(np.square(errors))) + COLLISION * sum(run.collisions + run.teleports for run in runs)


def _evaluate(search: Search, values: tuple[float, ...], executor: Executor) -> Evaluation:
    variant = replace(search.scenario, traffic=search.traffic(values))
    tasks = [executor.submit(_figures, replace(variant, seed=seed), search.duration) for seed in search.seeds]
    runs = tuple(task.result() for task in tasks)
    return Evaluation(values, misfit_of(variant, runs), runs)


def _figures(scenario: Scenario, duration: float) -> Figures:
    return figures_of(scenario, survey_job(scenario, duration, lambda *_: None))


@contextmanager
def _executor(workers: int) -> Iterator[Executor]:
    """Processes of their own, because each can hold one simulation."""
    executor = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        yield executor
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


def _read(search: Search) -> list[Evaluation]:
    if not search.log.is_file():
        return []
    first, *lines = search.log.read_text().splitlines()
    if json.loads(first) != {"problem": search.problem}:
        raise InputError(f"{search.folder}: holds a calibration of something else; give another --out")
    return [msgspec.json.decode(line, type=Evaluation) for line in lines]


def _write(search: Search, found: Evaluation) -> None:
    """One line per evaluation, below a line that says what they are evaluations of."""
    if not search.log.is_file():
        search.log.write_text(json.dumps({"problem": search.problem}) + "\n")
    with search.log.open("a") as file:
        file.write(json.dumps(asdict(found)) + "\n")


def _write_traffic(search: Search, best: Evaluation, tried: int) -> None:
    values = ", ".join(f"{p.name} = {value:g}" for p, value in zip(search.free, best.values, strict=True))
    seeds = ", ".join(map(str, search.seeds))
    header = f"# Found by `cosim calibrate` in {tried} evaluations with the seeds {seeds}:\n# {values}\n"
    content = msgspec.to_builtins(search.traffic(best.values))
    (search.folder / "traffic.yaml").write_text(header + yaml.safe_dump(content, sort_keys=False, width=120))
