"""The road from above with matplotlib: lanes, the group, its counterpart as outlines, the vehicles around in grey."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from matplotlib.transforms import Affine2D

from cosim.runs.road_view import Moving, RoadView

ROLE_COLOURS = ("#0072b2", "#d55e00", "#444444", "#009e73", "#cc79a7", "#b87a00", "#56b4e9", "#7b5ea7")
AHEAD, BEHIND = 35.0, 35.0  # [m] of road that is shown around the group


def window(view: RoadView) -> tuple[float, float]:
    """How far [m] the picture reaches behind and ahead of the middle of the group, over the whole episode."""
    s = np.array([member.s for member in view.members])
    rear = s - np.array([member.length for member in view.members])[:, None]
    with np.errstate(invalid="ignore"):
        span = np.nanmax(np.nanmax(s, axis=0) - np.nanmin(rear, axis=0)) if np.isfinite(s).any() else 0.0
    return 0.5 * float(span) + BEHIND, 0.5 * float(span) + AHEAD


def draw_road(axes: Axes, view: RoadView, k: int, driven: Sequence[bool], names: bool = True) -> None:
    """Draw the road at instant k. The vehicles that a policy drives have a black frame."""
    there = [(member.s[k], member.s[k] - member.length) for member in view.members if np.isfinite(member.s[k])]
    middle = 0.5 * (max(s for s, _ in there) + min(rear for _, rear in there)) if there else 0.0
    behind, ahead = window(view)
    axes.set(xlim=(middle - behind, middle + ahead), ylim=_across(view))
    _draw_lanes(axes, view)
    for neighbour in view.neighbours:
        _draw_vehicle(axes, neighbour, k, facecolor="#d9d9d9", edgecolor="#8c8c8c", lw=0.6, zorder=2)
    for role, ghost in enumerate(view.ghosts):
        _draw_vehicle(axes, ghost, k, fill=False, edgecolor=ROLE_COLOURS[role], lw=1.1, ls=(0, (2, 1.5)), zorder=3)
    for role, member in enumerate(view.members):
        edge = "black" if driven[role] else "none"
        _draw_vehicle(axes, member, k, facecolor=ROLE_COLOURS[role], edgecolor=edge, lw=1.2, zorder=4)
        if names and np.isfinite(member.s[k]):
            place = member.s[k] - member.length / 2, member.d[k]
            axes.text(*place, str(role), color="white", ha="center", va="center", fontsize=8, weight="bold", zorder=5)


def _across(view: RoadView) -> tuple[float, float]:
    """The range of d [m] that is shown: the group over the whole episode, and a lane more on each side."""
    d = np.concatenate([member.d for member in (*view.members, *view.ghosts)])
    d = d[np.isfinite(d)]
    return (float(d.min()) - 5.5, float(d.max()) + 5.5) if len(d) else (-5.5, 5.5)


def _draw_lanes(axes: Axes, view: RoadView) -> None:
    for lane in view.lanes:
        s, d = lane.centre.T
        half = 0.5 * lane.width
        axes.fill_between(s, d - half, d + half, color="#f3f3f3", lw=0, zorder=0)
        for side, outer in ((-half, lane.rightmost), (half, lane.leftmost)):
            style: Any = "-" if outer else (0, (6, 6))
            axes.plot(s, d + side, color="#7f7f7f", lw=1.0 if outer else 0.7, ls=style, zorder=1)


def _draw_vehicle(axes: Axes, vehicle: Moving, k: int, **style: Any) -> None:
    s, d = vehicle.s[k], vehicle.d[k]
    if not np.isfinite(s):
        return
    box = Rectangle((s - vehicle.length, d - vehicle.width / 2), vehicle.length, vehicle.width, **style)
    box.set_transform(Affine2D().rotate_around(s, d, vehicle.angle[k]) + axes.transData)
    axes.add_patch(box)
