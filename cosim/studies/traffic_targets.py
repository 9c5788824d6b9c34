"""Statistics of simulated traffic, compared with the recorded targets of the scenario."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from cosim.runs.traffic_survey import Survey
from cosim.spec.demand import Targets
from cosim.spec.scenario import Scenario
from gri.table import Table

KMH_PER_MS = 3.6
TRUCK_LENGTH = 7.0  # [m]; longer vehicles count as trucks
STANDING_SPEED = 0.5  # [m/s]; slower vehicles count as standing


@dataclass(frozen=True)
class TrafficStatistics:
    """Statistics of one survey after the warm-up; speeds in m/s, flows in veh/h, shares between 0 and 1.

    `speed` and `mainline` have one value per demand interval, `lanes` has one row (speed, share of samples) per lane
    from the left. `mainline` is the flow that enters the study area on the main road, `flow` the one on all roads.
    `hardest_braking` is in m/s²; `waiting` vehicles had not entered at the end.
    """

    seed: int
    mean_speed: float
    speed: tuple[float, ...]
    lanes: tuple[tuple[float, float], ...]
    flow: float
    mainline: tuple[float, ...]
    ramp_share: float
    long_share: float
    standing_share: float
    hardest_braking: float
    waiting: int
    collisions: int
    teleports: int


@dataclass(frozen=True)
class TargetCheck:
    """One target: its value, its relative tolerance, and the simulated value, in the same unit."""

    label: str
    target: float
    tolerance: float
    simulated: float

    @property
    def error(self) -> float:
        """Relative error, simulated / target − 1."""
        return self.simulated / self.target - 1

    @property
    def within_tolerance(self) -> bool:
        return abs(self.error) <= self.tolerance


def traffic_statistics(scenario: Scenario, result: Survey) -> TrafficStatistics:
    """The statistics of a survey of undisturbed traffic in this scenario."""
    begin, interval = scenario.traffic.warm_up, scenario.traffic.interval
    samples = result.samples[result.samples["time"] > begin + 1e-6]
    number = ((samples["time"] - begin - 1e-6) // interval).astype(int)
    lanes = samples.groupby("lane")["v"].agg(["mean", "size"])
    entries = result.samples.groupby("vehicle").first()
    entries = entries[entries["time"] > begin + 1e-6]
    ramps = {flow.name for flow in scenario.traffic.flows if flow.edges[0] != scenario.road.edges[0]}
    from_ramp = np.array([vehicle.rpartition(".")[0] in ramps for vehicle in map(str, entries.index)], dtype=bool)
    lasted = np.diff(np.append(np.unique(number) * interval, samples["time"].max() - begin))
    main = ((entries["time"][~from_ramp] - begin - 1e-6) // interval).astype(int)
    return TrafficStatistics(
        seed=scenario.seed,
        mean_speed=float(samples["v"].mean()),
        speed=tuple(samples.groupby(number)["v"].mean().tolist()),
        lanes=tuple((float(v), float(n) / len(samples)) for v, n in lanes.itertuples(index=False)),
        flow=3600 * len(entries) / float(lasted.sum()),
        mainline=tuple((3600 * np.bincount(main, minlength=len(lasted)) / lasted).tolist()),
        ramp_share=float(from_ramp.mean()),
        long_share=float((entries["length"] > TRUCK_LENGTH).mean()),
        standing_share=float((samples["v"] < STANDING_SPEED).mean()),
        hardest_braking=result.hardest_braking,
        waiting=result.waiting,
        collisions=result.collisions,
        teleports=result.teleports,
    )


def target_checks(targets: Targets, simulated: TrafficStatistics) -> Iterator[TargetCheck]:
    """A check per target: mean speed, flow on the main road per demand interval, share from the ramps."""
    yield TargetCheck("mean speed", targets.mean_speed, targets.speed_tolerance, simulated.mean_speed)
    for k, flow in enumerate(simulated.mainline):
        target = targets.mainline[min(k, len(targets.mainline) - 1)]
        yield TargetCheck(f"main road, interval {k + 1}", target, targets.flow_tolerance, flow)
    yield TargetCheck("share from the ramps", targets.ramp_share, targets.flow_tolerance, simulated.ramp_share)


def targets_reached(targets: Targets, simulated: TrafficStatistics) -> bool:
    """Whether all targets are reached within their tolerances, without collisions and teleports."""
    return (
        not simulated.collisions
        and not simulated.teleports
        and all(check.within_tolerance for check in target_checks(targets, simulated))
    )


def statistics_table(name: str, scenario: Scenario, runs: Sequence[TrafficStatistics]) -> Table:
    """The statistics: one column per seed, and one with the targets if the scenario has some."""
    targets = scenario.traffic.targets
    shown = ["target"] if targets else []
    return Table(
        name,
        ["", *shown, *(f"seed {run.seed}" for run in runs)],
        [[label, *([target] if shown else []), *values] for label, target, values in _rows(targets, runs)],
        statistics_frame(runs).to_dict("records"),
        title=f"{name}: undisturbed traffic after the warm-up",
    )


def _rows(targets: Targets | None, runs: Sequence[TrafficStatistics]) -> Iterator[tuple[str, str, list[str]]]:
    yield _row("mean speed [km/h]", targets, runs, 0, [run.mean_speed for run in runs], KMH_PER_MS, 1)
    yield "  by demand interval", "", [_listed(np.multiply(KMH_PER_MS, run.speed), 1) for run in runs]
    yield "  by lane, from the left", "", [_listed([KMH_PER_MS * v for v, _ in run.lanes], 0) for run in runs]
    yield (
        "vehicles by lane, from the left [%]",
        "",
        [_listed([100 * share for _, share in run.lanes], 0) for run in runs],
    )
    yield "flow into the study area [veh/h]", "", [f"{run.flow:.0f}" for run in runs]
    for k in range(len(runs[0].mainline)):
        values = [run.mainline[k] for run in runs]
        yield _row(f"  main road, interval {k + 1} [veh/h]", targets, runs, 1 + k, values, 1.0, 0)
    yield _row("  from the ramps [%]", targets, runs, -1, [run.ramp_share for run in runs], 100.0, 1)
    yield "vehicles longer than 7 m [%]", "", [f"{100 * run.long_share:.1f}" for run in runs]
    yield "standing vehicles (< 0.5 m/s) [%]", "", [f"{100 * run.standing_share:.1f}" for run in runs]
    yield "hardest braking [m/s²]", "", [f"{run.hardest_braking:.1f}" for run in runs]
    yield "vehicles waiting to enter at the end", "", [str(run.waiting) for run in runs]
    yield "collisions / teleports", "0 / 0", [f"{run.collisions} / {run.teleports}" for run in runs]
    if targets:
        yield "all targets reached", "", ["yes" if targets_reached(targets, run) else "no" for run in runs]


def _row(
    label: str,
    targets: Targets | None,
    runs: Sequence[TrafficStatistics],
    check: int,
    values: Sequence[float],
    factor: float,
    digits: int,
) -> tuple[str, str, list[str]]:
    """A row of values with a target (number `check`), with relative errors; "!" marks values beyond the tolerance."""
    texts = [f"{factor * value:.{digits}f}" for value in values]
    if targets is None:
        return label, "", texts
    found = [list(target_checks(targets, run))[check] for run in runs]
    target = f"{factor * found[0].target:.{digits}f} ± {100 * found[0].tolerance:.0f} %"
    return (
        label,
        target,
        [
            f"{t} ({100 * c.error:+.1f} %){'' if c.within_tolerance else ' !'}"
            for t, c in zip(texts, found, strict=True)
        ],
    )


def _listed(values: Sequence[float] | np.ndarray, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def statistics_frame(runs: Sequence[TrafficStatistics]) -> pd.DataFrame:
    """One row per seed for a file; lists are spread over columns."""
    return pd.DataFrame(
        [
            {
                "seed": run.seed,
                "mean_speed": run.mean_speed,
                **{f"speed_{k + 1}": v for k, v in enumerate(run.speed)},
                **{f"mainline_{k + 1}": flow for k, flow in enumerate(run.mainline)},
                **{f"lane_{k + 1}_speed": v for k, (v, _) in enumerate(run.lanes)},
                **{f"lane_{k + 1}_share": share for k, (_, share) in enumerate(run.lanes)},
                **{
                    name: getattr(run, name)
                    for name in (
                        "flow", "ramp_share", "long_share", "standing_share", "hardest_braking", "waiting",
                        "collisions", "teleports",
                    )
                },
            }
            for run in runs
        ]
    )  # fmt: skip
