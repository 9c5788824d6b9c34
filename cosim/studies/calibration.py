"""Calibration of drivers and bottleneck, so that the traffic of a scenario reaches its recorded targets.

The misfit is the mean over seeds and targets of (relative error / tolerance)². Below 1, the targets are reached on
average. A simulation is slow and noisy and has no derivatives. The optimiser is therefore COBYQA (Ragonneau 2022, in
scipy), which fits quadratic models to few evaluations inside bounds. It is deterministic, and every evaluation is
stored, so that the same call continues a stopped calibration.
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
from cosim.studies.traffic_targets import TrafficStatistics, target_checks, traffic_statistics
from gri.errors import InputError, guarded_reading
from gri.storage.whole_files import write_whole

MAX_CHANGE = 0.25  # of a parameter, relative to its initial value
FIRST_STEP, LAST_STEP = 0.04, 0.005  # trust-region radii, relative to the initial values
SIMULATION_LIMIT = 24 * 3600.0  # [s]
COLLISION_PENALTY = 100.0  # added to the misfit for each collision or teleport

Tell = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Parameter:
    """A free number of a traffic description: `tau`, `limit` (all limits by one factor) or `limit.K` (the K-th)."""

    name: str

    @property
    def interval(self) -> int | None:
        """The demand interval (0-based) whose limit this is; None for all."""
        number = self.name.partition(".")[2]
        return int(number) - 1 if number else None

    def value_in(self, traffic: Traffic) -> float:
        """Its value: time headway `tau` [s] or limit [m/s]; the first one where it scales several."""
        if self.name == "tau":
            return traffic.vehicles[0].tau
        assert traffic.bottleneck is not None, "checked by `parameters`"
        return traffic.bottleneck.limits[self.interval or 0]

    def replaced_in(self, traffic: Traffic, value: float) -> Traffic:
        """The traffic with this value of the parameter; others that it scales change by the same factor."""
        factor = value / self.value_in(traffic)
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
    """The named parameters. Raises `InputError` for a name that this traffic does not have."""
    intervals = len(traffic.bottleneck.limits) if traffic.bottleneck else 0
    known = ["tau", *(["limit"] if intervals else []), *(f"limit.{k + 1}" for k in range(intervals))]
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"--free: got {unknown[0]!r}, this traffic has {', '.join(known)}")
    return tuple(Parameter(name) for name in names)


@dataclass(frozen=True)
class Evaluation:
    """One evaluation: the values of the parameters, the misfit, and the statistics of each seed."""

    values: tuple[float, ...]
    misfit: float
    runs: tuple[TrafficStatistics, ...]


@dataclass(frozen=True)
class Calibration:
    """A calibration and its folder: `evaluations.jsonl` has all evaluations, `traffic.yaml` the best traffic.

    `duration` is the simulated time after the warm-up [s].
    """

    scenario: Scenario
    free: tuple[Parameter, ...]
    seeds: tuple[int, ...]
    duration: float
    folder: Path

    def traffic(self, values: Sequence[float]) -> Traffic:
        pairs = zip(self.free, values, strict=True)
        return reduce(lambda traffic, pair: pair[0].replaced_in(traffic, pair[1]), pairs, self.scenario.traffic)

    @property
    def problem(self) -> str:
        """Hash of everything that all evaluations of the folder have in common."""
        content = (self.scenario, [p.name for p in self.free], self.seeds, self.duration)
        return hashlib.sha256(msgspec.json.encode(content)).hexdigest()

    @property
    def log(self) -> Path:
        return self.folder / "evaluations.jsonl"


def calibrate(calibration: Calibration, evaluations: int, workers: int, tell: Tell) -> Evaluation:
    """Run up to `evaluations` evaluations, stored ones included; write and return the best one.

    `tell` is called with "evaluations", their number so far and `evaluations`. Raises `InputError` if the scenario has
    no targets, or if the folder has another calibration.
    """
    if calibration.scenario.traffic.targets is None:
        raise InputError(
            "traffic.targets: this scenario has no targets; give the recorded mean speed, flow and ramp share"
        )
    calibration.folder.mkdir(parents=True, exist_ok=True)
    known = {found.values: found for found in _read(calibration)}
    initial = np.array([parameter.value_in(calibration.scenario.traffic) for parameter in calibration.free])
    requested: list[tuple[float, ...]] = []
    with _executor(workers) as executor:

        def misfit(scaled: Float[np.ndarray, " P"]) -> float:
            values = tuple(float(value) for value in np.round(initial * scaled, 3))
            if values not in requested:
                tell("evaluations", len(requested), evaluations)
                requested.append(values)
            if values not in known:
                known[values] = _evaluate(calibration, values, executor)
                _write(calibration, known[values])
            return known[values].misfit

        options = {"maxfev": evaluations, "initial_tr_radius": FIRST_STEP, "final_tr_radius": LAST_STEP}
        bounds = [(1 - MAX_CHANGE, 1 + MAX_CHANGE)] * len(initial)
        minimize(misfit, np.ones(len(initial)), method="COBYQA", bounds=bounds, options=options)
    tell("evaluations", evaluations, evaluations)
    best = min(known.values(), key=lambda found: found.misfit)
    _write_traffic(calibration, best, len(known))
    return best


def misfit_of(scenario: Scenario, runs: Sequence[TrafficStatistics]) -> float:
    """Mean over seeds and targets of (relative error / tolerance)², plus the penalty of collisions and teleports."""
    targets = scenario.traffic.targets
    assert targets is not None, "checked by `calibrate`"
    errors = [check.error / check.tolerance for run in runs for check in target_checks(targets, run)]
    return float(np.mean(np.square(errors))) + COLLISION_PENALTY * sum(run.collisions + run.teleports for run in runs)


def _evaluate(calibration: Calibration, values: tuple[float, ...], executor: Executor) -> Evaluation:
    variant = replace(calibration.scenario, traffic=calibration.traffic(values))
    tasks = [
        executor.submit(_simulate, replace(variant, seed=seed), calibration.duration) for seed in calibration.seeds
    ]
    try:
        runs = tuple(task.result(SIMULATION_LIMIT) for task in tasks)
    except TimeoutError:
        raise RuntimeError(
            f"waited {SIMULATION_LIMIT / 3600:g} h for a simulation of one seed, then ended it"
        ) from None
    return Evaluation(values, misfit_of(variant, runs), runs)


def _simulate(scenario: Scenario, duration: float) -> TrafficStatistics:
    return traffic_statistics(scenario, survey_job(scenario, duration, lambda *_: None))


@contextmanager
def _executor(workers: int) -> Iterator[Executor]:
    """Worker processes; a process can hold one simulation only."""
    executor = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        yield executor
    finally:
        for process in list((executor._processes or {}).values()):  # there is no public way to end running tasks
            process.kill()
        executor.shutdown(wait=True, cancel_futures=True)


def _read(calibration: Calibration) -> list[Evaluation]:
    if not calibration.log.is_file():
        return []
    with guarded_reading(calibration.log, "log of a calibration", "remove it, then the search begins anew"):
        text = calibration.log.read_text(encoding="utf-8")
        if not text.endswith("\n"):  # a killed command left half a line
            text = text[: text.rfind("\n") + 1]
            write_whole(calibration.log, text)
        first, *lines = text.splitlines()
        if json.loads(first) != {"problem": calibration.problem}:
            raise InputError(f"{calibration.folder}: has a calibration with other settings; give another --out")
        return [msgspec.json.decode(line, type=Evaluation) for line in lines]


def _write(calibration: Calibration, found: Evaluation) -> None:
    """Append an evaluation to the log, whose first line identifies the calibration."""
    if not calibration.log.is_file():
        write_whole(calibration.log, json.dumps({"problem": calibration.problem}) + "\n")
    with calibration.log.open("a", encoding="utf-8") as file:
        file.write(json.dumps(asdict(found)) + "\n")


def _write_traffic(calibration: Calibration, best: Evaluation, evaluations: int) -> None:
    values = ", ".join(f"{p.name} = {value:g}" for p, value in zip(calibration.free, best.values, strict=True))
    seeds = ", ".join(map(str, calibration.seeds))
    header = f"# Found by `cosim calibrate` in {evaluations} evaluations with the seeds {seeds}:\n# {values}\n"
    content = msgspec.to_builtins(calibration.traffic(best.values))
    write_whole(calibration.folder / "traffic.yaml", header + yaml.safe_dump(content, sort_keys=False, width=120))
