"""The files and the tables of a score of simulated traffic: `score.csv`, `score.json`, and a space-time diagram."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from cosim.studies.observation_windows import seen_through, windows_of
from cosim.studies.traffic_samples import with_headways
from cosim.studies.traffic_score import (
    STATISTICS,
    TrafficScore,
    constant_traffic,
    seed_interval,
    traffic_score,
    with_interactions,
)
from gri.errors import InputError
from gri.table import Table

FASTEST_SHOWN = 25.0  # [m/s], end of the colour scale


def write_score(
    folder: Path,
    simulated: Sequence[pd.DataFrame],
    recorded: pd.DataFrame,
    other: pd.DataFrame | None,
    views: int,
    offset: float,
) -> list[Table]:
    """Score simulations (samples of one each) against a recording; write the files and return the tables.

    `other` is another part of the recording, for the ceiling. Raises `InputError` if the recording is too short, or if
    no simulated vehicle is seen through its windows.
    """
    windows, tested = windows_of(recorded)
    if not windows:
        raise InputError("--test: no part of the recording is 4 s long or longer; give a longer one")
    seen = seen_through(simulated, windows, views, offset)
    if seen.empty:
        raise InputError(
            f"--offset: got {offset:g} m, at which no simulated vehicle is where the recording looks"
            f" (x from {tested['x'].min():.0f} to {tested['x'].max():.0f} m, lanes"
            f" {', '.join(f'{lane:g}' for lane in sorted(tested['lane'].dropna().unique()))}); say where its x = 0 is"
        )
    ours, theirs = (with_interactions(with_headways(t.assign(source=t["window"]))) for t in (seen, tested))
    rest = None if other is None else with_interactions(with_headways(windows_of(other)[1]))
    score = traffic_score(ours, theirs, rest)
    constant = traffic_score(constant_traffic(theirs, theirs if rest is None else rest), theirs, rest)
    records = _records(score, constant)
    pd.DataFrame(records).to_csv(folder / "score.csv", index=False, float_format="%.5g")
    total = {"score": score.total, "constant": constant.total, "ceiling": score.ceiling}
    total |= {"windows": len(windows), "views": views}
    (folder / "score.json").write_text(json.dumps({**total, "quantities": records}, indent=1) + "\n")
    draw_space_time(ours, theirs, folder / "space_time.png")
    return _tables(score, constant, records, len(windows))


def _records(score: TrafficScore, constant: TrafficScore) -> list[dict[str, Any]]:
    """A row for each quantity, for the files."""
    likelihoods = [
        {
            "kind": "likelihood",
            "quantity": s.feature.name,
            "weight": s.feature.weight,
            "simulated": s.share,
            "lowest_seed": min(s.by_seed),
            "highest_seed": max(s.by_seed),
            "seeds_low": seed_interval(s.by_seed)[0],
            "seeds_high": seed_interval(s.by_seed)[1],
            "constant": c.share,
            "uniform": s.uniform,
            "recorded": s.ceiling,
            "of_ceiling": s.of_ceiling,
        }
        for s, c in zip(score.features, constant.features, strict=True)
    ]
    return likelihoods + [
        {
            "kind": "statistic",
            "quantity": s.name,
            "weight": STATISTICS[s.name][1],
            "simulated": s.simulated,
            "lowest_seed": min(s.by_seed),
            "highest_seed": max(s.by_seed),
            "seeds_low": seed_interval(s.by_seed)[0],
            "seeds_high": seed_interval(s.by_seed)[1],
            "constant": c.simulated,
            "recorded": s.recorded,
            "recorded_low": s.low,
            "recorded_high": s.high,
            "inside": s.inside,
        }
        for s, c in zip(score.statistics, constant.statistics, strict=True)
    ]


def _tables(score: TrafficScore, constant: TrafficScore, rows: Sequence[dict[str, Any]], windows: int) -> list[Table]:
    likelihoods = [
        (
            s.feature.label,
            f"{100 * s.share:.1f}",
            f"{100 * min(s.by_seed):.1f}–{100 * max(s.by_seed):.1f}",
            f"{100 * c.share:.1f}",
            f"{100 * s.uniform:.1f}",
            f"{100 * s.ceiling:.1f}",
            "?" if np.isnan(s.of_ceiling) else f"{100 * s.of_ceiling:.0f}",
        )
        for s, c in zip(score.features, constant.features, strict=True)
    ]
    totals = [f"{100 * one:.1f}" for one in (score.total, constant.total, score.ceiling)]
    likelihoods.append(
        ("weighted score", totals[0], "", totals[1], "", totals[2], f"{100 * score.total / score.ceiling:.0f}")
    )
    statistics = [
        (
            STATISTICS[s.name][0],
            _number(s.simulated),
            f"{_number(min(s.by_seed))}–{_number(max(s.by_seed))}",
            f"{_number(s.recorded)} ({_number(s.low)}–{_number(s.high)})",
            "-" if np.isnan(s.recorded) or np.isnan(s.simulated) else "yes" if s.inside else "no",
        )
        for s in score.statistics
    ]
    return [
        Table(
            "likelihoods",
            ("quantity", "simulated", "per seed", "constant", "uniform", "other part", "of it"),
            likelihoods,
            [row for row in rows if row["kind"] == "likelihood"],
            title="Share of the recording's own likelihood [%]",
            note="Constant: every vehicle at the means of the recording. Uniform: all values alike. Other part: what"
            " another part of the recording reaches, the ceiling; of it: the simulated share in relation to that, in"
            " %. The score has the three quantities of whole windows with a weight in it as well (docs/realism.md).",
            labels=1,
        ),
        Table(
            "statistics",
            ("quantity", "simulated", "per seed", "recorded (95 %)", "inside"),
            statistics,
            [row for row in rows if row["kind"] == "statistic"],
            title=f"Whole windows ({windows} recorded)",
            labels=1,
        ),
    ]


def _number(value: float) -> str:
    return "?" if np.isnan(value) else f"{value:.2f}"


def draw_space_time(simulated: pd.DataFrame, recorded: pd.DataFrame, path: Path) -> None:
    """Draw positions over time, coloured by speed: the longest recorded window beside one view of the same size.

    The lane is the one with the lowest recorded speed in it, so that waves show if there are any.
    """
    spans = recorded.groupby("window")["time"].agg(lambda t: t.max() - t.min())
    ours = recorded[recorded["window"] == spans.idxmax()]
    lane = ours.groupby("lane")["v"].mean().idxmin()
    duration = spans.max()
    lengths = simulated.groupby("window")["time"].agg(lambda t: t.max() - t.min())
    alike = [w for w in lengths.index if abs(lengths[w] - duration) <= 0.1 * duration + 2] or [lengths.idxmax()]
    theirs = simulated[simulated["window"] == alike[len(alike) // 2]]
    with matplotlib.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(9, 3.4), layout="constrained")
        axes = figure.subplots(1, 2, sharey=True)
        speeds = ScalarMappable(Normalize(0, FASTEST_SHOWN), "viridis")
        for axis, name, table in zip(axes, ("recorded", "simulated"), (ours, theirs), strict=True):
            part = table[table["lane"] == lane]
            axis.scatter(part["time"] - table["time"].min(), part["x"], c=speeds.to_rgba(part["v"].to_numpy()), s=5)
            axis.set_title(f"{name}, lane {lane:g}")
            axis.set_xlabel("time [s]")
        axes[0].set_ylabel("position [m]")
        figure.colorbar(speeds, ax=axes, label="speed [m/s]")
        figure.savefig(path, dpi=130)
