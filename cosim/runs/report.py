"""What a person sees of a run: a table in the terminal and a picture of one episode."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch
from rich.markup import escape
from rich.table import Table

from cosim.world.episode import ARRIVED, INTERRUPTED, LEFT_ALONE, Ending

DRIVER_NAMES = {
    "gri": "GRI",
    "airl": "GRI (paper)",
    "nri": "NRI",
    "supervised": "Supervised",
    "idm": "IDM",
    "constant_velocity": "constant velocity",
    "sumo": "left to SUMO",
    "recorded": "as recorded",
}
ROLE_COLOURS = ("#0072b2", "#d55e00", "#444444")
EDGE_COLOURS = {"follow": "#009e73", "yield": "#e69f00", "cut_in": "#cc79a7"}
ROLES = {
    "car_following": ("0 (last)", "1 (middle)", "2 (leader)"),
    "merge": ("0 (merging)", "1 (lag)", "2 (leader)"),
}

_CURVES = {
    "s": "position s [m]",
    "d": "lateral position d [m]",
    "v": "speed [m/s]",
    "gap": "net gap ahead [m]",
}

Row = tuple[str, Callable[[pd.DataFrame], str]]


def summary(groups: pd.DataFrame) -> Table:
    """The headline table: one column per driver, in the order of the groups table."""
    table = Table(title="Groups driven, and the same groups left alone", title_justify="left")
    table.add_column("")
    drivers = list(dict.fromkeys(groups["driver"]))
    for driver in drivers:
        table.add_column(_name(driver), justify="right")
    parts = [groups[groups["driver"] == driver] for driver in drivers]
    for label, value in _ROWS:
        table.add_row(escape(label), *(value(part) for part in parts))
    return table


def _name(driver: str) -> str:
    return DRIVER_NAMES.get(driver, driver)


def _of(count: int, total: int) -> str:
    return f"{count} of {total}" if total else "-"


def _endings(groups: pd.DataFrame, *, interrupted: bool) -> str:
    """How often which ending that is neither arriving nor a contact, by others' doing or by the driver's own."""
    others = groups["ending"].isin(INTERRUPTED)
    own = ~groups["ending"].isin([*INTERRUPTED, *ARRIVED, Ending.CONTACT])
    kinds = groups.loc[others if interrupted else own, "ending"].value_counts()
    return (
        ", ".join(f"{n} {kind.replace('_', ' ')}" for kind, n in zip(map(str, kinds.index), kinds, strict=True)) or "0"
    )


def _complete(groups: pd.DataFrame) -> pd.DataFrame:
    return groups[~groups["ending"].isin(INTERRUPTED)]


def _edges(groups: pd.DataFrame) -> str:
    """How often each relation was inferred, most frequent first."""
    if "edge_1_0" not in groups or groups["edge_1_0"].isna().all():
        return "-"
    pairs = [name for name in map(str, groups.columns) if name.startswith("edge_") and not name.endswith("_p")]
    found = [
        (n / len(groups), f"{pair[5]}→{pair[7]} {kind}")
        for pair in pairs
        for kind, n in groups[pair].value_counts().items()
        if kind != "none"
    ]
    return "\n".join(f"{edge} {100 * share:.0f} %" for share, edge in sorted(found, reverse=True)) or "no edge"


def _as_expected(groups: pd.DataFrame) -> str:
    if "graph_as_expected" not in groups or groups["graph_as_expected"].isna().all():
        return "-"
    return _of(int(groups["graph_as_expected"].sum()), len(groups))


_ROWS: tuple[Row, ...] = (
    ("groups", lambda g: str(len(g))),
    ("  driven to the end", lambda g: _of(int(g["ending"].isin(ARRIVED).sum()), len(g))),
    ("  not in time, or not on the road", lambda g: _endings(g, interrupted=False)),
    ("  interrupted by others", lambda g: _endings(g, interrupted=True)),
    ("inferred edges", _edges),
    ("  whole graph as expected", _as_expected),
    ("success (of those not interrupted)", lambda g: _of(int(g["success"].sum()), len(_complete(g)))),
    ("collisions", lambda g: str(int(g["contact"].sum()))),
    ("minimum gap [m]: worst / median", lambda g: f"{g['min_gap'].min():.1f} / {g['min_gap'].median():.1f}"),
    ("minimum TTC [s]: worst / median", lambda g: f"{g['min_ttc'].min():.1f} / {g['min_ttc'].median():.1f}"),
    ("mean speed [m/s]", lambda g: f"{g['mean_speed'].mean():.1f}"),
    ("steps with |jerk| <= 3 m/s³ [%]", lambda g: f"{100 * g['jerk_within_3'].mean():.1f}"),
    ("hardest braking [m/s²]: driven / after", lambda g: _hardest(g)),
    ("groups with hard braking after", lambda g: str(int((g["hard_braking_after"] > 0).sum()))),
)


def _hardest(groups: pd.DataFrame) -> str:
    return f"{groups['min_acceleration'].min():.1f} / {groups['min_acceleration_after'].min():.1f}"


def most_eventful(groups: pd.DataFrame, steps: pd.DataFrame) -> int:
    """The driven episode whose leader's speed varies most: the one in which there is most to see."""
    first = groups["driver"].iloc[0]
    leader = steps[(steps["driver"] == first) & (steps["role"] == 2) & steps["during_drive"]]
    return int(leader.groupby("episode")["v"].agg(np.ptp).idxmax())


def picture(tables: Mapping[str, pd.DataFrame], path: Path, episode: int | None = None) -> None:
    """Draw one episode: positions, speeds and gaps over time, who drove whom, and the graph; PNG or SVG by suffix."""
    groups, steps = tables["groups"], tables["steps"]
    episode = most_eventful(groups, steps) if episode is None else episode
    driver = groups["driver"].iloc[0]
    group = groups[(groups["episode"] == episode) & (groups["driver"] == driver)].iloc[0].to_dict()
    own = steps[(steps["episode"] == episode) & (steps["driver"] == driver)]
    twin = _twin(group, groups, steps)
    with matplotlib.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        shown = _CURVES if group["rule"] == "merge" else {k: v for k, v in _CURVES.items() if k != "d"}
        figure = Figure(figsize=(10, 1 + 2 * len(shown)), layout="constrained")
        right = ["graph"] * (len(shown) - 1) + ["text"]
        layout = figure.subplot_mosaic(
            [list(row) for row in zip(shown, right, strict=True)],
            width_ratios=[2.6, 1],
            height_ratios=[1.5, *[1] * (len(shown) - 1)],
        )
        for name, label in shown.items():
            _curves(layout[name], own, twin, name, label, ROLES[group["rule"]], (0, 1) if name == "gap" else (0, 1, 2))
            _phases(layout[name], group, label=name == "s", driver=_name(driver))
        layout["gap"].set_xlabel("time since take-over [s]")
        layout["s"].legend(loc="upper left", frameon=False)
        _graph(layout["graph"], group)
        _facts(layout["text"], group, twin is not None)
        figure.suptitle(
            f"Episode {episode}: {_name(driver)} drives "
            f"{group['vehicle_0']} (0) and {group['vehicle_1']} (1), the leader is {group['vehicle_2']} (2)",
            x=0.01,
            ha="left",
        )
        figure.savefig(path, dpi=150)


def _twin(group: dict[str, Any], groups: pd.DataFrame, steps: pd.DataFrame) -> pd.DataFrame | None:
    """The steps of the same group left to SUMO, where that was recorded."""
    same = groups["driver"].isin(LEFT_ALONE) & (groups["vehicle_0"] == group["vehicle_0"])
    if group["driver"] in LEFT_ALONE or not same.any():
        return None
    number = groups[same]["episode"].iloc[0]
    return steps[(steps["episode"] == number) & steps["driver"].isin(LEFT_ALONE)]


def _curves(
    axes: Axes,
    own: pd.DataFrame,
    twin: pd.DataFrame | None,
    column: str,
    label: str,
    names: tuple[str, ...],
    roles: tuple[int, ...],
) -> None:
    """One line per vehicle; dashed and thin: the same vehicle left to SUMO."""
    thin: dict[str, Any] = {"lw": 1, "ls": "--", "alpha": 0.7}
    thick: dict[str, Any] = {"lw": 1.8}
    for role in roles:
        for frame, style in ((twin, thin), (own, thick)):
            if frame is not None:
                part = frame[(frame["role"] == role) & frame["present"]]
                label_of = f"vehicle {names[role]}" if frame is own else None
                axes.plot(_since(part, own), part[column], color=ROLE_COLOURS[role], label=label_of, **style)
    axes.set_ylabel(label)
    axes.margins(x=0)
    if column in ("v", "gap"):
        axes.set_ylim(bottom=0)


def _since(part: pd.DataFrame, own: pd.DataFrame) -> pd.Series:
    return part["time"] - own.loc[own["during_drive"], "time"].min()


def _phases(axes: Axes, group: dict[str, Any], label: bool, driver: str) -> None:
    """Shade who drives vehicles 0 and 1: before, during and after the take-over."""
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
    axes.set(xlim=(-1.3, 1.3), ylim=(-0.7, 2.7), aspect="equal", title="inferred graph")
    axes.axis("off")
    for role in range(3):
        axes.add_patch(Circle((0, role), 0.2, color=ROLE_COLOURS[role], zorder=3))
        axes.text(0, role, str(role), color="white", ha="center", va="center", weight="bold", zorder=4)
    edges = [(i, j) for i in range(3) for j in range(3) if i != j and f"edge_{i}_{j}" in group]
    shown = [(i, j) for i, j in edges if group[f"edge_{i}_{j}"] not in ("none", None) and _known(group, i, j)]
    for i, j in shown:
        kind = group[f"edge_{i}_{j}"]
        colour = EDGE_COLOURS[kind]
        bend = 0.35 if i > j else -0.35
        if abs(i - j) == 2:
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


def _known(group: dict[str, Any], i: int, j: int) -> bool:
    return not pd.isna(group[f"edge_{i}_{j}"])


def _facts(axes: Axes, group: dict[str, Any], has_twin: bool) -> None:
    lines = [
        f"ended by: {group['ending'].replace('_', ' ')}",
        f"driven for {group['drive_duration']:.1f} s",
        f"minimum gap {group['min_gap']:.1f} m",
        f"minimum TTC {group['min_ttc']:.1f} s",
        "",
        "an arrow i → j says what j does",
        "towards i; solid: driven run,",
        "dashed: left to SUMO" if has_twin else "",
    ]
    axes.axis("off")
    axes.text(0, 1, "\n".join(lines), va="top", transform=axes.transAxes)
