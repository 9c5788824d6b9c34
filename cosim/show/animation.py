"""An episode as numbers that `animation.js` plays in a browser, and a page with one such animation."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from cosim.show.episode_view import View
from cosim.show.templates import page


def data_of(view: View) -> dict[str, Any]:
    """JSON content of an episode: road coordinates in m, time in s since the take-over; null where nothing is known."""
    s, d = view.feature("s"), view.feature("d")
    return {
        "time": _rounded(view.time - view.taken),
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
                "time": round(belief.time - view.taken, 2),
                "from": belief.sender,
                "to": belief.receiver,
                "type": belief.type,
                "p": round(belief.probability, 3),
            }
            for belief in view.beliefs
            if belief.type != "none"
        ],
    }


def script_of(view: View) -> str:
    """The same as text that may stand inside a script element."""
    return json.dumps(data_of(view), separators=(",", ":")).replace("</", "<\\/")


def html(view: View, title: str) -> str:
    """A page of its own with the animation of one episode; it needs no other file and no network."""
    return page("episode.html.j2", title=title, animation=script_of(view), view=view)


def _angle(s: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Heading relative to the road [rad] from the path; 0 while standing."""
    ds, dd = np.gradient(s), np.gradient(d)
    return np.where(np.hypot(ds, dd) > 0.05, np.arctan2(dd, np.maximum(ds, 1e-9)), 0.0)


def _rounded(values: Sequence[float] | np.ndarray) -> list[float | None]:
    return [round(float(value), 3) if np.isfinite(value) else None for value in values]
