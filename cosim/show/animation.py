"""An animation of an episode for the browser: its data, which `animation.js` plays, and an HTML page around it."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from cosim.show.episode_view import EpisodeView
from cosim.show.templates import page


def data_of(view: EpisodeView) -> dict[str, Any]:
    """The data of an episode for JSON: road coordinates [m], time since the take-over [s]; null for missing values."""
    s, d = view.feature("s"), view.feature("d")
    return {
        "time": _rounded(view.time - view.takeover_time),
        "drive_duration": round(float(view.group["drive_duration"]), 2),
        "ending": str(view.group["ending"]).replace("_", " "),
        "vehicles": [
            {
                "role": role,
                "id": view.ids[role],
                "length": round(float(view.length[role]), 2),
                "width": round(float(view.width[role]), 2),
                "s": _rounded(np.where(view.present[:, role], s[:, role], np.nan)),
                "d": _rounded(d[:, role]),
                "angle": _rounded(_angle(s[:, role], d[:, role])),
                "v": _rounded(view.feature("v")[:, role]),
                "driven": view.driven[:, role].astype(int).tolist(),
                "gap": _rounded(view.gap[:, role]),
                "ttc": _rounded(np.where(view.ttc[:, role] < 1e3, view.ttc[:, role], np.nan)),
            }
            for role in range(len(view.ids))
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


def script_of(view: EpisodeView) -> str:
    """The data as JSON text that is safe inside a script element: no `<`, so that nothing in it can be a tag."""
    return json.dumps(data_of(view), separators=(",", ":")).replace("<", "\\u003c")


def html(view: EpisodeView, title: str) -> str:
    """An HTML page with the animation of one episode. It needs no other file and no network."""
    return page("episode.html.j2", title=title, animation=script_of(view), view=view)


def _angle(s: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Heading relative to the road [rad], from the path; 0 at standstill."""
    ds, dd = np.gradient(s), np.gradient(d)
    return np.where(np.hypot(ds, dd) > 0.05, np.arctan2(dd, np.maximum(ds, 1e-9)), 0.0)


def _rounded(values: Sequence[float] | np.ndarray) -> list[float | None]:
    return [round(float(value), 3) if np.isfinite(value) else None for value in values]
