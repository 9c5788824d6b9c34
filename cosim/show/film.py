"""An episode as a film: GIF by pillow, MP4 where ffmpeg is installed; no display is needed."""

import shutil
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.transforms import Affine2D

from cosim.runs.episode_figure import ROLE_COLOURS
from cosim.show.episode_view import View
from gri.errors import InputError


def film(view: View, path: Path) -> None:
    """Write the film at the speed it happened, one picture per simulation step."""
    if path.suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise InputError("--format mp4: ffmpeg is not installed; install it, or take gif or html")
    rate = round(1 / float(np.diff(view.time).mean()))
    writer = FFMpegWriter(fps=rate) if path.suffix == ".mp4" else PillowWriter(fps=rate)
    with matplotlib.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(8, 4.5), layout="constrained")
        above, below = figure.subplots(2, 1, height_ratios=[1, 1])
        moment = _gaps(below, view)
        with writer.saving(figure, str(path), dpi=100):
            for k in range(len(view.time)):
                _road(above, view, k)
                moment.set_xdata([view.time[k] - view.taken] * 2)
                writer.grab_frame()


def _gaps(axes: Axes, view: View):
    """The gaps over time; returns the line that marks the present."""
    time = view.time - view.taken
    for role in range(2):
        axes.plot(time, view.gap[:, role], color=ROLE_COLOURS[role], label=f"vehicle {role}")
    axes.axvspan(0, float(view.group["drive_duration"]), color="#0072b2", alpha=0.08, lw=0)
    axes.set(xlabel="time since take-over [s]", ylabel="net gap ahead [m]")
    axes.legend(frameon=False)
    return axes.axvline(time[0], color="0.2", lw=1)


def _road(axes: Axes, view: View, k: int) -> None:
    """The group from above in road coordinates."""
    s, d = view.feature("s"), view.feature("d")
    there = view.present[k]
    front = float(s[k, there].max()) if there.any() else float(s[k].max())
    span = float((s.max(axis=1) - (s - view.length).min(axis=1))[view.present.all(axis=1)].max()) + 15
    axes.clear()
    axes.set(xlim=(front + 5 - span, front + 5), ylim=(d[view.present].min() - 4, d[view.present].max() + 4))
    axes.set(xlabel="position s [m]", ylabel="lateral position d [m]")
    for role in np.flatnonzero(there):
        angle = float(np.arctan2(np.gradient(d[:, role])[k], max(np.gradient(s[:, role])[k], 1e-6)))
        box = Rectangle(
            (s[k, role] - view.length[role], d[k, role] - view.width[role] / 2),
            view.length[role],
            view.width[role],
            facecolor=ROLE_COLOURS[role],
            edgecolor="black" if view.driven[k, role] else "none",
        )
        box.set_transform(Affine2D().rotate_around(s[k, role], d[k, role], angle) + axes.transData)
        axes.add_patch(box)
        axes.text(s[k, role] - view.length[role] / 2, d[k, role] + 1.6, f"{role}", ha="center")
    known = [belief for belief in view.beliefs if belief.type != "none"]
    words = "; ".join(f"{b.receiver} {b.type.replace('_', ' ')} {b.sender} (p {b.probability:.2f})" for b in known[:4])
    axes.set_title(f"{view.time[k] - view.taken:.1f} s   {words}", loc="left", fontsize=9)
