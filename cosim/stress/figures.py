"""Measures over intensity, one figure per perturbation, in the style of the paper's figures 8 to 11."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.batch.group_statistics import Measure
from cosim.spec.perturbations import KINDS
from cosim.stress.estimates import MEASURES
from cosim.stress.plan import NOMINAL, TRAFFIC_KINDS

PANELS = ("completed_without_contact", "contact", "order_kept", "min_gap", "jerk_95", "follower_braking")
LATERAL = "lateral_change"  # shown instead of the jerk where vehicles change lanes
CURVES: tuple[dict[str, Any], ...] = (
    {"color": "#0072B2", "ls": "-", "marker": "o"},
    {"color": "#D55E00", "ls": "--", "marker": "s"},
    {"color": "#009E73", "ls": ":", "marker": "^"},
    {"color": "#CC79A7", "ls": "-.", "marker": "D"},
    {"color": "0.35", "ls": (0, (6, 1, 1, 1, 1, 1)), "marker": "X"},
)
"""Of the policies of a figure: markers and line styles tell them apart in grey print."""
STYLE: dict[Any, Any] = {
    "figure.dpi": 150,
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "cosim",
    "savefig.bbox": "tight",
}


def draw(estimates: pd.DataFrame, kinds: list[str], folder: Path, *, lane_changes: bool) -> list[Path]:
    """Draw each perturbation that has a feasible start, as PNG and SVG; returns the files.

    Of more than five policies, the first one is in every figure of a perturbation: KIND, KIND-2 and so on.
    `lane_changes`: whether the groups change lanes, so that Δy replaces the jerk.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for kind in (kind for kind in kinds if (estimates["perturbation"] == kind).any()):
        for k, policies in enumerate(_parts(list(dict.fromkeys(estimates["policy"])))):
            part = estimates[estimates["policy"].isin(policies)]
            name = f"{kind}-{k + 1}" if k else kind
            written += _saved(curves(part, kind, lane_changes=lane_changes), folder / name)
    return written


def _parts(policies: Sequence[str]) -> list[list[str]]:
    """The policies in parts of as many as there are styles, with the first one in each."""
    first, others, room = policies[0], policies[1:], len(CURVES) - 1
    return [[first, *others[k : k + room]] for k in range(0, max(len(others), 1), room)]


def _saved(figure: Figure, stem: Path) -> Iterator[Path]:
    for suffix in (".png", ".svg"):
        path = stem.with_suffix(suffix)
        with matplotlib.rc_context(STYLE):
            figure.savefig(path, metadata={"Date": None} if suffix == ".svg" else None)
        yield path


def curves(estimates: pd.DataFrame, kind: str, *, lane_changes: bool = False) -> Figure:
    """Six measures over the intensity of one perturbation, one line per policy with its 95 % band."""
    spec, names = KINDS[kind], [LATERAL if lane_changes and name == "jerk_95" else name for name in PANELS]
    measures = [next(measure for measure in MEASURES if measure.name == name) for name in names]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10, 5.6), layout="constrained")
        axes = figure.subplots(2, 3, sharex=True)
        for axis, measure in zip(axes.flat, measures, strict=True):
            _panel(axis, estimates[estimates["measure"] == measure.name], kind, measure)
        for axis in axes[-1]:
            axis.set_xlabel(f"intensity {spec.symbol} [{spec.unit}]" if spec.unit else f"intensity {spec.symbol}")
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncol=len(labels), frameon=False)
        shown = "bands" if _intensities(estimates, kind) > 1 else "bars"
        title = f"{kind.replace('_', ' ')} ({shown}: 95 % intervals; hollow markers: without perturbation)"
        figure.suptitle(title, x=0.01, ha="left")
    return figure


def _intensities(estimates: pd.DataFrame, kind: str) -> int:
    return estimates.loc[estimates["perturbation"] == kind, "intensity"].nunique()


def _panel(axis: Axes, part: pd.DataFrame, kind: str, measure: Measure) -> None:
    scale = 100.0 if measure.share else 1.0
    neutral = None if kind in TRAFFIC_KINDS else KINDS[kind].neutral
    if _intensities(part, kind) == 1:
        _points(axis, part, kind, scale, neutral)
        _scale(axis, measure)
        return
    for k, policy in enumerate(dict.fromkeys(part["policy"])):
        mine = part[part["policy"] == policy]
        line = mine[mine["perturbation"] == kind].sort_values("intensity")
        style = CURVES[k]
        colour, marker = style["color"], style["marker"]
        axis.plot(line["intensity"], scale * line["value"], ms=4, lw=1.4, label=policy, **style)
        axis.fill_between(line["intensity"], scale * line["low"], scale * line["high"], color=colour, alpha=0.15, lw=0)
        nominal = mine[mine["perturbation"] == NOMINAL]
        if neutral is not None and len(nominal):
            axis.plot(neutral, scale * nominal["value"].iloc[0], marker=marker, ms=5, mfc="white", color=colour)
    _scale(axis, measure)


def _points(axis: Axes, part: pd.DataFrame, kind: str, scale: float, neutral: float | None) -> None:
    """A single intensity: each policy's value with its interval, side by side, and the undisturbed ones."""
    cells = {} if neutral is None else {neutral: part[part["perturbation"] == NOMINAL]}
    disturbed = part[part["perturbation"] == kind]
    intensity = float(disturbed["intensity"].iloc[0])
    cells[intensity] = disturbed
    apart = 0.06 * (abs(intensity - neutral) if neutral is not None else 1.0)
    for k, policy in enumerate(dict.fromkeys(part["policy"])):
        style: dict[str, Any] = CURVES[k] | {"ls": "", "ms": 5, "capsize": 2, "lw": 1.0}
        for x, rows in cells.items():
            for _, row in rows[rows["policy"] == policy].iterrows():
                value, low, high = (scale * row[name] for name in ("value", "low", "high"))
                bars = [[max(value - low, 0.0)], [max(high - value, 0.0)]]
                named: dict[str, Any] = {"label": policy} if x == intensity else {"mfc": "white"}
                axis.errorbar(x + apart * (k - 2), value, yerr=bars, **(style | named))
    axis.set_xticks([*cells])


def _scale(axis: Axes, measure: Measure) -> None:
    axis.set_ylabel(f"{measure.title} [{'%' if measure.share else measure.unit}]")
    if measure.share:
        axis.set_ylim(-3, 103)
    elif measure.name != LATERAL:
        axis.set_ylim(bottom=0)
