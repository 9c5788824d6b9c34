"""The picture of one episode: curves over time beside the same group left to SUMO, and the inferred graph."""

from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch

from cosim.runs.road_picture import ROLE_COLOURS, draw_road
from cosim.runs.road_view import RoadView, road_view
from cosim.runs.summary import driver_name, shortest_time
from cosim.world.outcome_columns import group_size

ROLE_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
_MOMENTS = ("road at the take-over", "road in the middle", "road at the end")
EDGE_COLOURS = {"follow": "#009e73", "yield": "#e69f00", "cut_in": "#cc79a7"}
MERGE_ROLES = ("0 (merging)", "1 (lag)", "2 (leader)")
_STYLE: dict[Any, Any] = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
_CURVES = {
    "s": "position s [m]",
    "d": "lateral position d [m]",
    "v": "speed [m/s]",
    "gap": "net gap ahead [m]",
}


class EpisodeFigure(Figure):
    """A matplotlib figure that notebooks show by themselves, without pyplot and without a magic command."""

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()


def most_eventful(steps: pd.DataFrame) -> int:
    """Number of the driven episode whose leader's speed varies most."""
    leader = steps[~steps["counterpart"] & (steps["role"] == steps["role"].max()) & steps["during_drive"]]
    return int(str(leader.groupby("episode")["v"].agg(np.ptp).idxmax()))


def picture(
    tables: Mapping[str, pd.DataFrame], path: Path, episode: int | None = None, folder: Path | None = None
) -> None:
    """Write `figure` to a file; the suffix (.png, .svg, .pdf) says in which format."""
    with matplotlib.rc_context(_STYLE):
        figure(tables, episode, folder).savefig(path, dpi=150)


def figure(tables: Mapping[str, pd.DataFrame], episode: int | None = None, folder: Path | None = None) -> Figure:
    """One episode: the road from above at three instants, curves over time, and the inferred graph.

    Args:
        tables: `steps` and `groups` of a run.
        episode: its number; by default the driven episode whose leader changes speed most.
        folder: the folder of the run, which has the lanes and the vehicles around; without it the road is empty.
    """
    groups, steps = tables["groups"], tables["steps"]
    episode = most_eventful(steps) if episode is None else episode
    (row,) = groups[groups["episode"] == episode].to_dict("records")
    group = {str(name): value for name, value in row.items()}
    driver, size = str(group["driver"]), group_size(group)
    of_episode = steps["episode"] == episode
    own, left = steps[of_episode & ~steps["counterpart"]], steps[of_episode & steps["counterpart"]]
    counterpart = left if len(left) else None
    with matplotlib.rc_context(_STYLE):
        shown = _CURVES if group["rule"] == "merge" else {k: v for k, v in _CURVES.items() if k != "d"}
        drawn = EpisodeFigure(figsize=(10, 4.2 + 2 * len(shown)), layout="constrained")
        right = ["graph"] * (len(shown) - 1) + ["text"]
        mosaic: Any = [[name] * 2 for name in _MOMENTS] + [list(row) for row in zip(shown, right, strict=True)]
        layout = drawn.subplot_mosaic(
            mosaic,
            width_ratios=[2.6, 1],
            height_ratios=[0.6] * len(_MOMENTS) + [1.5, *[1] * (len(shown) - 1)],
        )
        _roads([layout[name] for name in _MOMENTS], road_view(tables, episode, folder), own, group)
        for name, label in shown.items():
            roles = tuple(range(size - 1 if name == "gap" else size))
            _curves(layout[name], own, counterpart, name, label, _role_names(group["rule"], size), roles)
            _phases(layout[name], group, label=name == "s", driver=driver_name(driver))
        layout["gap"].set_xlabel("time since take-over [s]")
        handles, labels = layout["s"].get_legend_handles_labels()
        own_first = sorted(range(len(labels)), key=lambda k: (not labels[k].startswith("vehicle"), labels[k]))
        chosen = [handles[k] for k in own_first], [labels[k] for k in own_first]
        layout["s"].legend(*chosen, loc="upper left", frameon=False, ncols=2)
        _graph(layout["graph"], group)
        _facts(layout["text"], group, counterpart is not None)
        drawn.suptitle(
            f"Episode {episode}: {driver_name(driver)} drives "
            f"{_followers(group, size)}, the leader is {group[f'vehicle_{size - 1}']} ({size - 1})",
            x=0.01,
            ha="left",
        )
        return drawn


def _role_names(rule: str, size: int) -> tuple[str, ...]:
    """The roles as a legend names them."""
    if rule == "merge":
        return MERGE_ROLES
    between = ["1 (middle)"] if size == 3 else [str(role) for role in range(1, size - 1)]
    return "0 (last)", *between, f"{size - 1} (leader)"


def _followers(group: Mapping[str, Any], size: int) -> str:
    """The vehicles behind the leader; of many the first and the last one."""
    shown = range(size - 1) if size <= 4 else (0, size - 2)
    return (" to " if size > 4 else " and ").join(f"{group[f'vehicle_{role}']} ({role})" for role in shown)


def _roads(rows: Sequence[Axes], view: RoadView, own: pd.DataFrame, group: dict[str, Any]) -> None:
    """The road at the take-over, in the middle and at the end of the drive."""
    begin, duration = float(group["takeover_time"]), float(group["drive_duration"])
    for axes, share in zip(rows, (0.0, 0.5, 1.0), strict=True):
        k = int(np.abs(view.time - (begin + share * duration)).argmin())
        driven = {int(role) for role in own.loc[own["driven"], "role"]}
        draw_road(axes, view, k, [role in driven for role in range(group_size(group))])
        axes.set_title(f"{view.time[k] - begin:.1f} s", loc="left", fontsize=8, pad=2)
        axes.set_ylabel("d [m]")
        axes.tick_params(labelsize=7)
    rows[-1].set_xlabel("position s [m]; grey: other vehicles; outlines: the group left to SUMO", fontsize=8)


def _curves(
    axes: Axes,
    own: pd.DataFrame,
    counterpart: pd.DataFrame | None,
    column: str,
    label: str,
    names: tuple[str, ...],
    roles: tuple[int, ...],
) -> None:
    """One line per vehicle, with a marker of its own; dashed and thin, with hollow markers: left to SUMO."""
    thin: dict[str, Any] = {"lw": 1, "ls": "--", "alpha": 0.8, "mfc": "white", "ms": 4}
    thick: dict[str, Any] = {"lw": 1.8, "ms": 5}
    for role in roles:
        for frame, style in ((counterpart, thin), (own, thick)):
            if frame is not None:
                part = frame[(frame["role"] == role) & frame["present"]]
                every = max(len(part) // 7, 1)
                style = {**style, "marker": ROLE_MARKERS[role], "markevery": (role * every // 3, every)}
                label_of = f"vehicle {names[role]}" if frame is own else f"{role} left to SUMO"
                axes.plot(_since(part, own), part[column], color=ROLE_COLOURS[role], label=label_of, **style)
    axes.set_ylabel(label)
    axes.margins(x=0)
    if column in ("v", "gap"):
        axes.set_ylim(bottom=0)


def _since(part: pd.DataFrame, own: pd.DataFrame) -> pd.Series:
    return part["time"] - own.loc[own["during_drive"], "time"].min()


def _phases(axes: Axes, group: dict[str, Any], label: bool, driver: str) -> None:
    """Shade the time under the policy, and name the three phases of the episode."""
    low, high = axes.get_xlim()
    axes.axvspan(0, group["drive_duration"], color="#0072b2", alpha=0.08, lw=0)
    if label:
        middle = ((low, "history"), (0.0, f"{driver} drives"), (group["drive_duration"], "handed back"))
        for (begin, name), end in zip(middle, (0.0, group["drive_duration"], high), strict=True):
            axes.text((begin + end) / 2, 1.0, name, transform=axes.get_xaxis_transform(), ha="center", va="bottom")
    for instant in (0.0, group["drive_duration"]):
        axes.axvline(instant, color="0.5", lw=0.8)


def _graph(axes: Axes, group: dict[str, Any]) -> None:
    """The inferred graph: an arrow i → j labelled with what j does towards i."""
    size = group_size(group)
    axes.set(xlim=(-1.3, 1.3), ylim=(-0.7, size - 0.3), aspect="equal", title="inferred graph")
    axes.axis("off")
    for role in range(size):
        axes.add_patch(Circle((0, role), 0.2, color=ROLE_COLOURS[role], zorder=3))
        axes.text(0, role, str(role), color="white", ha="center", va="center", weight="bold", zorder=4)
    edges = [(i, j) for i in range(size) for j in range(size) if i != j and f"edge_{i}_{j}" in group]
    shown = [(i, j) for i, j in edges if group[f"edge_{i}_{j}"] not in ("none", None) and _is_known(group, i, j)]
    for i, j in shown:
        kind = group[f"edge_{i}_{j}"]
        colour = EDGE_COLOURS[kind]
        bend = 0.35 if i > j else -0.35
        if abs(i - j) > 1:
            bend *= 1.3
        side = 0.55 * abs(i - j) * (1 if i > j else -1)
        axes.add_patch(
            FancyArrowPatch(
                (0, i), (0, j), connectionstyle=f"arc3,rad={bend}", arrowstyle="-|>", mutation_scale=14,
                shrinkA=15, shrinkB=15, color=colour, lw=1.8,
            )
        )  # fmt: skip
        text = f"{kind.replace('_', ' ')}\np = {group[f'edge_{i}_{j}_p']:.2f}"
        axes.text(-side, (i + j) / 2, text, color=colour, ha="center", va="center")
    if not shown:
        axes.text(0.5, 1, "none" if edges else "this driver\nhas no graph", va="center")


def _is_known(group: dict[str, Any], i: int, j: int) -> bool:
    return not pd.isna(group[f"edge_{i}_{j}"])


def _facts(axes: Axes, group: dict[str, Any], has_counterpart: bool) -> None:
    lines = [
        f"ended by: {group['ending'].replace('_', ' ')}",
        f"driven for {group['drive_duration']:.1f} s",
        f"minimum gap {group['min_gap']:.1f} m",
        f"minimum TTC {shortest_time(group['min_ttc'])} s",
        "",
        "an arrow i → j says what j does",
        "towards i; solid: driven run,",
        "dashed: left to SUMO" if has_counterpart else "",
    ]
    axes.axis("off")
    axes.text(0, 1, "\n".join(lines), va="top", transform=axes.transAxes)
