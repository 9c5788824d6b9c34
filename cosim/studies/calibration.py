"""Calibration of drivers and bottleneck, so that the traffic of a scenario resembles the recorded one.

The misfit is the mean over seeds and targets of (relative error / tolerance)². Below 1, the targets are reached on
average. With a recording, UNLIKENESS · (1 − its weighted score) is added (`cosim.studies.traffic_score`). A simulation
is slow and noisy and has no derivatives. The optimiser is therefore COBYQA (Ragonneau 2022, in scipy), which fits
quadratic models to few evaluations inside bounds. It is deterministic, and every evaluation is stored, so that the same
call continues a stopped calibration. Before, `screen` says which parameters matter.
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
import pandas as pd
import yaml
from jaxtyping import Float
from msgspec.structs import replace
from scipy.optimize import minimize

from cosim.runs.traffic_survey import survey_job
from cosim.spec.demand import Traffic
from cosim.spec.scenario import Scenario
from cosim.studies.free_parameters import Parameter
from cosim.studies.observation_windows import seen_through, windows_of
from cosim.studies.screening import Effect, effects, paths, scaled
from cosim.studies.traffic_samples import with_headways
from cosim.studies.traffic_score import traffic_score, with_interactions
from cosim.studies.traffic_targets import TrafficStatistics, target_checks, traffic_statistics
from gri.errors import InputError, guarded_reading
from gri.processes import end_with_parent
from gri.storage.whole_files import write_whole

MAX_CHANGE = 0.25  # of a parameter, relative to its initial value
FIRST_STEP, LAST_STEP = 0.04, 0.005  # trust-region radii, relative to the initial values
SIMULATION_LIMIT = 24 * 3600.0  # [s]
COLLISION_PENALTY = 100.0  # added to the misfit for each collision or teleport
UNLIKENESS = 10.0  # weight of the recording: 10 points of the score count as much as all targets at their tolerances

Tell = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Evaluation:
    """One evaluation: the values of the parameters, the misfit, and the statistics of each seed.

    `score` is the weighted score against the recording, between 0 and 1; None without a recording.
    """

    values: tuple[float, ...]
    misfit: float
    runs: tuple[TrafficStatistics, ...]
    score: float | None = None


@dataclass(frozen=True)
class Likeness:
    """A part of a recording to resemble: its samples, where its x = 0 is on the road [m], and views per window."""

    samples: pd.DataFrame
    offset: float
    views: int

    @property
    def content(self) -> str:
        """Hash of the samples and the settings."""
        rows = pd.util.hash_pandas_object(self.samples, index=False).to_numpy().tobytes()
        return hashlib.sha256(rows + f"{self.offset} {self.views}".encode()).hexdigest()

    def score(self, simulated: Sequence[pd.DataFrame]) -> float:
        """The weighted score of simulations, seen through the recording's windows."""
        windows, tested = windows_of(self.samples)
        seen = seen_through(simulated, windows, self.views, self.offset)
        ours, theirs = (with_interactions(with_headways(t.assign(source=t["window"]))) for t in (seen, tested))
        return traffic_score(ours, theirs, None).total


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
    likeness: Likeness | None = None

    def traffic(self, values: Sequence[float]) -> Traffic:
        pairs = zip(self.free, values, strict=True)
        return reduce(lambda traffic, pair: pair[0].replaced_in(traffic, pair[1]), pairs, self.scenario.traffic)

    @property
    def initial(self) -> list[float]:
        """The values of the free parameters in the scenario."""
        return [parameter.value_in(self.scenario.traffic) for parameter in self.free]

    @property
    def problem(self) -> str:
        """Hash of everything that all evaluations of the folder have in common."""
        content = [self.scenario, [p.name for p in self.free], self.seeds, self.duration]
        content += [] if self.likeness is None else [self.likeness.content]
        return hashlib.sha256(msgspec.json.encode(content)).hexdigest()

    @property
    def log(self) -> Path:
        return self.folder / "evaluations.jsonl"


def calibrate(calibration: Calibration, evaluations: int, workers: int, tell: Tell) -> Evaluation:
    """Run up to `evaluations` evaluations, stored ones included; write and return the best one.

    `tell` is called with "evaluations", their number so far and `evaluations`. Raises `InputError` if the scenario has
    no targets, or if the folder has another calibration.
    """
    known = _known(calibration)
    initial = np.array(calibration.initial)
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


def screen(calibration: Calibration, number: int, seed: int, workers: int, tell: Tell) -> dict[str, list[Effect]]:
    """Elementary effects of the free parameters along `number` paths, for the misfit, the mean speed and the score.

    Every parameter moves within ±MAX_CHANGE of its initial value; effects are those of its whole range. Evaluations are
    stored as those of `calibrate`, and not repeated. Raises `InputError` like `calibrate`.
    """
    known, names = _known(calibration), [parameter.name for parameter in calibration.free]
    points = paths(len(names), number, np.random.default_rng(seed))
    found: list[Evaluation] = []
    with _executor(workers) as executor:
        for point in points.reshape(-1, len(names)):
            tell("evaluations", len(found), number * (len(names) + 1))
            values = scaled(calibration.initial, MAX_CHANGE, point)
            if values not in known:
                known[values] = _evaluate(calibration, values, executor)
                _write(calibration, known[values])
            found.append(known[values])
    results = {
        "misfit": [one.misfit for one in found],
        "mean speed [m/s]": [float(np.mean([run.mean_speed for run in one.runs])) for one in found],
    }
    if calibration.likeness is not None:
        results["score"] = [np.nan if one.score is None else one.score for one in found]
    shape = points.shape[:2]
    return {name: effects(names, points, np.array(values).reshape(shape)) for name, values in results.items()}


def _known(calibration: Calibration) -> dict[tuple[float, ...], Evaluation]:
    """The stored evaluations by their values; the folder is made if there is none."""
    if calibration.scenario.traffic.targets is None:
        raise InputError(
            "traffic.targets: this scenario has no targets; give the recorded mean speed, flow and ramp share"
        )
    calibration.folder.mkdir(parents=True, exist_ok=True)
    return {found.values: found for found in _read(calibration)}


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
        found = [task.result(SIMULATION_LIMIT) for task in tasks]
    except TimeoutError:
        raise RuntimeError(
            f"waited {SIMULATION_LIMIT / 3600:g} h for a simulation of one seed, then ended it"
        ) from None
    runs = tuple(statistics for statistics, _ in found)
    if calibration.likeness is None:
        return Evaluation(values, misfit_of(variant, runs), runs)
    score = calibration.likeness.score([samples for _, samples in found])
    return Evaluation(values, misfit_of(variant, runs) + UNLIKENESS * (1 - score), runs, score)


def _simulate(scenario: Scenario, duration: float) -> tuple[TrafficStatistics, pd.DataFrame]:
    found = survey_job(scenario, duration, lambda *_: None)
    return traffic_statistics(scenario, found), found.samples


@contextmanager
def _executor(workers: int) -> Iterator[Executor]:
    """Worker processes; a process can hold one simulation only."""
    executor = ProcessPoolExecutor(workers, get_context("spawn"), end_with_parent)
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
