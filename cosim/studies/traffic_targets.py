"""The figures by which simulated traffic is judged, and how they compare with what was recorded."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from rich.markup import escape
from rich.table import Table

from cosim.runs.traffic_survey import Survey
from cosim.spec.demand import Targets
from cosim.spec.scenario import Scenario

KMH = 3.6  # km/h in a m/s
LONG = 7.0  # [m], longer vehicles count as trucks
STANDING = 0.5  # [m/s]


@dataclass(frozen=True)
class Figures:
    """What one survey shows after the warm-up; speeds in m/s, flows in veh/h, shares between 0 and 1.

    `speed` and `mainline` have a value per demand interval, `lanes` a row (speed, share of vehicles) per lane from the
    left. `mainline` is what enters the study area on the main road, `flow` what enters it anywhere.
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
class Check:
    """One target: what was wanted, how far [relative] one may be off, and what was reached."""

    label: str
    wanted: float
    tolerance: float
    reached: float

    @property
    def error(self) -> float:
        """Relative error."""
        return self.reached / self.wanted - 1

    @property
    def met(self) -> bool:
        return abs(self.error) <= self.tolerance


def figures_of(scenario: Scenario, result: Survey) -> Figures:
    """The figures of a survey of that scenario."""
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
    return Figures(
        seed=scenario.seed,
        mean_speed=float(samples["v"].mean()),
        speed=tuple(samples.groupby(number)["v"].mean().tolist()),
        lanes=tuple((float(v), float(n) / len(samples)) for v, n in lanes.itertuples(index=False)),
        flow=3600 * len(entries) / float(lasted.sum()),
        mainline=tuple((3600 * np.bincount(main, minlength=len(lasted)) / lasted).tolist()),
        ramp_share=float(from_ramp.mean()),
        long_share=float((entries["length"] > LONG).mean()),
        standing_share=float((samples["v"] < STANDING).mean()),
        hardest_braking=result.hardest_braking,
        waiting=result.waiting,
        collisions=result.collisions,
        teleports=result.teleports,
    )


def checks(targets: Targets, reached: Figures) -> Iterator[Check]:
    """How the figures compare with each target."""
    yield Check("mean speed", targets.mean_speed, targets.speed_tolerance, reached.mean_speed)
    for k, flow in enumerate(reached.mainline):
        wanted = targets.mainline[min(k, len(targets.mainline) - 1)]
        yield Check(f"main road, interval {k + 1}", wanted, targets.flow_tolerance, flow)
    yield Check("share from the ramp", targets.ramp_share, targets.flow_tolerance, reached.ramp_share)


def met(targets: Targets, reached: Figures) -> bool:
    """Whether every target is reached, and nobody collided or was teleported."""
    return not reached.collisions and not reached.teleports and all(check.met for check in checks(targets, reached))


def table_of(name: str, scenario: Scenario, runs: Sequence[Figures]) -> Table:
    """The figures as a person reads them, a column per seed, beside the targets where the scenario has some."""
    table = Table(title=f"{name}: undisturbed traffic after the warm-up", title_justify="left")
    targets = scenario.traffic.targets
    for header in ("", *(["target"] if targets else []), *(f"seed {run.seed}" for run in runs)):
        table.add_column(header, justify="right" if header else "left", no_wrap=not header)
    for label, wanted, values in _rows(targets, runs):
        table.add_row(escape(label), *([wanted] if targets else []), *values)
    return table


def _rows(targets: Targets | None, runs: Sequence[Figures]) -> Iterator[tuple[str, str, list[str]]]:
    yield _row("mean speed [km/h]", targets, runs, 0, [run.mean_speed for run in runs], KMH, 1)
    yield "  by interval", "", [_listed(np.multiply(KMH, run.speed), 1) for run in runs]
    yield "  by lane, left to right", "", [_listed([KMH * v for v, _ in run.lanes], 0) for run in runs]
    yield "vehicles by lane [%]", "", [_listed([100 * share for _, share in run.lanes], 0) for run in runs]
    yield "flow in [veh/h]", "", [f"{run.flow:.0f}" for run in runs]
    for k in range(len(runs[0].mainline)):
        values = [run.mainline[k] for run in runs]
        yield _row(f"  main road, interval {k + 1}", targets, runs, 1 + k, values, 1.0, 0)
    yield _row("  from the ramp [%]", targets, runs, -1, [run.ramp_share for run in runs], 100.0, 1)
    yield "longer than 7 m [%]", "", [f"{100 * run.long_share:.1f}" for run in runs]
    yield "standing (< 0.5 m/s) [%]", "", [f"{100 * run.standing_share:.1f}" for run in runs]
    yield "hardest braking [m/s²]", "", [f"{run.hardest_braking:.1f}" for run in runs]
    yield "waiting at the end", "", [str(run.waiting) for run in runs]
    yield "collisions / teleports", "0 / 0", [f"{run.collisions} / {run.teleports}" for run in runs]
    if targets:
        yield "all targets reached", "", ["yes" if met(targets, run) else "no" for run in runs]


def _row(
    label: str,
    targets: Targets | None,
    runs: Sequence[Figures],
    which: int,
    values: Sequence[float],
    unit: float,
    digits: int,
) -> tuple[str, str, list[str]]:
    """A row of figures that have a target: with relative errors, and a mark where they are beyond the tolerance."""
    texts = [f"{unit * value:.{digits}f}" for value in values]
    if targets is None:
        return label, "", texts
    found = [list(checks(targets, run))[which] for run in runs]
    wanted = f"{unit * found[0].wanted:.{digits}f} ± {100 * found[0].tolerance:.0f} %"
    return (
        label,
        wanted,
        [f"{t} ({100 * c.error:+.1f} %){'' if c.met else ' !'}" for t, c in zip(texts, found, strict=True)],
    )


def _listed(values: Sequence[float] | np.ndarray, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def frame_of(runs: Sequence[Figures]) -> pd.DataFrame:
    """A row per seed, lists spread over columns, for a file."""
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
