"""An animation of episodes for the browser: their data, which `animation.js` plays, and an HTML page around it."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from cosim.runs.road_view import Moving, RoadView
from cosim.runs.summary import driver_name, shortest_time
from cosim.show.episode_view import EpisodeView
from cosim.show.templates import page

SHOWN = 120.0  # [m] from the group, within which other vehicles are in the data of a page


def data_of(view: EpisodeView, road: RoadView, title: str = "") -> dict[str, Any]:
    """The data of an episode for JSON: road coordinates [m], time since the take-over [s]; null for missing values."""
    s, d = view.feature("s"), view.feature("d")
    near = [(first, last, vehicle) for vehicle in road.neighbours for first, last in _shown(vehicle, road)]
    return {
        "title": title,
        "text": description(view, road),
        "time": _rounded(view.time - view.takeover_time),
        "drive_duration": round(float(view.group["drive_duration"]), 2),
        "ending": str(view.group["ending"]).replace("_", " "),
        "vehicles": [
            {
                **_sizes(road.members[role]),
                "role": role,
                "s": _rounded(np.where(view.present[:, role], s[:, role], np.nan)),
                "d": _rounded(d[:, role]),
                "angle": _rounded(np.nan_to_num(road.members[role].angle)),
                "v": _rounded(view.feature("v")[:, role]),
                "driven": view.driven[:, role].astype(int).tolist(),
                "gap": _rounded(view.gap[:, role]),
                "ttc": _rounded(np.where(view.ttc[:, role] < 1e3, view.ttc[:, role], np.nan)),
            }
            for role in range(len(view.ids))
        ],
        "ghosts": [{**_sizes(ghost), **_places(ghost), "role": role} for role, ghost in enumerate(road.ghosts)],
        "neighbours": [
            {**_sizes(vehicle), **_places(vehicle, slice(first, last)), "first": first} for first, last, vehicle in near
        ],
        "lanes": [
            {
                "s": _rounded(lane.centre[:, 0], 2),
                "d": _rounded(lane.centre[:, 1], 2),
                "width": lane.width,
                "rightmost": lane.rightmost,
                "leftmost": lane.leftmost,
            }
            for lane in road.lanes
        ],
        "edges": [
            {
                "time": round(edge.time - view.takeover_time, 2),
                "from": edge.sender,
                "to": edge.receiver,
                "type": edge.type,
                "p": round(edge.probability, 3),
            }
            for edge in view.inferred_edges
            if edge.type != "none"
        ],
    }


def description(view: EpisodeView, road: RoadView) -> str:
    """The animation in words, for readers that cannot see it."""
    group = view.group
    names = ", ".join(f"{vehicle} ({role})" for role, vehicle in enumerate(view.ids))
    text = [
        f"The road from above with the vehicles {names}, driven by {driver_name(view.driver)} for"
        f" {group['drive_duration']:.1f} s; ended by: {str(group['ending']).replace('_', ' ')}."
    ]
    if "min_gap" in group:
        text.append(
            f"Minimum gap {group['min_gap']:.1f} m, minimum time to collision {shortest_time(group['min_ttc'])} s."
        )
    if group.get("contact_with"):
        text.append(f"Contact: {group['contact_with']}.")
    text.append(f"{len(road.neighbours)} other vehicles are around." if road.neighbours else "")
    text.append("Outlines show the same group left to SUMO." if road.ghosts else "")
    return " ".join(part for part in text if part)


def script_of(view: EpisodeView, road: RoadView, title: str = "") -> str:
    """The data as JSON text that is safe inside a script element."""
    return json.dumps(data_of(view, road, title), separators=(",", ":")).replace("<", "\\u003c")


def html(drives: Sequence[tuple[EpisodeView, RoadView]], title: str) -> str:
    """An HTML page with the animation of one episode, or of several drives of the same start side by side.

    It needs no other file and no network.
    """
    several = len(drives) > 1
    names = [driver_name(view.driver) if several else "" for view, _ in drives]
    scripts = [script_of(view, road, name) for (view, road), name in zip(drives, names, strict=True)]
    view, road = drives[0]
    outcomes = [(driver_name(other.driver), other.group) for other, _ in drives]
    return page("episode.html.j2", title=title, animations=scripts, view=view, road=road, outcomes=outcomes)


def _sizes(vehicle: Moving) -> dict[str, Any]:
    return {"id": vehicle.name, "length": round(vehicle.length, 2), "width": round(vehicle.width, 2)}


def _places(vehicle: Moving, rows: slice = slice(None)) -> dict[str, list[float | None]]:
    return {name: _rounded(getattr(vehicle, name)[rows], 2) for name in ("s", "d", "angle")}


def _shown(vehicle: Moving, road: RoadView) -> list[tuple[int, int]]:
    """The first and last index (exclusive) at which another vehicle is within SHOWN of the group; none if never."""
    s = np.array([member.s for member in road.members])
    with np.errstate(invalid="ignore"):
        near = (np.abs(s - vehicle.s) < SHOWN).any(axis=0)
    rows = np.flatnonzero(near)
    return [(int(rows[0]), int(rows[-1]) + 1)] if len(rows) else []


def _rounded(values: Sequence[float] | np.ndarray, digits: int = 3) -> list[float | None]:
    return [round(float(value), digits) if np.isfinite(value) else None for value in values]
