"""A video of an episode: GIF by pillow, or MP4 if ffmpeg is installed. No display is needed."""

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
from cosim.show.episode_view import EpisodeView
from gri.errors import InputError


def write_video(view: EpisodeView, path: Path) -> None:
    """Write a video in real time, one frame per simulation step. Raises `InputError` for MP4 without ffmpeg."""
    if path.suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise InputError("--format mp4: ffmpeg is not installed; install it, or use --format gif or html")
    rate = round(1 / float(np.diff(view.time).mean()))
    writer = FFMpegWriter(fps=rate) if path.suffix == ".mp4" else PillowWriter(fps=rate)
    with matplotlib.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(8, 4.5), layout="constrained")
        above, below = figure.subplots(2, 1, height_ratios=[1, 1])
        now = _draw_gaps(below, view)
        with writer.saving(figure, str(path), dpi=100):
            for k in range(len(view.time)):
                _draw_road(above, view, k)
                now.set_xdata([view.time[k] - view.takeover_time] * 2)
                writer.grab_frame()


def _draw_gaps(axes: Axes, view: EpisodeView):
    """Draw the gaps over time; returns the line that marks the current time."""
    time = view.time - view.takeover_time
    for role in range(2):
        axes.plot(time, view.gap[:, role], color=ROLE_COLOURS[role], label=f"vehicle {role}")
    axes.axvspan(0, float(view.group["drive_duration"]), color="#0072b2", alpha=0.08, lw=0)
    axes.set(xlabel="time since take-over [s]", ylabel="net gap ahead [m]")
    axes.legend(frameon=False)
    return axes.axvline(time[0], color="0.2", lw=1)


def _draw_road(axes: Axes, view: EpisodeView, k: int) -> None:
    """Draw the group at instant k from above, in road coordinates."""
    s, d = view.feature("s"), view.feature("d")
    present = view.present[k]
    front = float(s[k, present].max()) if present.any() else float(s[k].max())
    span = float((s.max(axis=1) - (s - view.length).min(axis=1))[view.present.all(axis=1)].max()) + 15
    axes.clear()
    axes.set(xlim=(front + 5 - span, front + 5), ylim=(d[view.present].min() - 4, d[view.present].max() + 4))
    axes.set(xlabel="position s [m]", ylabel="lateral position d [m]")
    for role in np.flatnonzero(present):
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
    edges = [edge for edge in view.inferred_edges if edge.type != "none"]
    graph = "; ".join(
        f"{e.sender} → {e.receiver}: {e.type.replace('_', ' ')} (p {e.probability:.2f})" for e in edges[:4]
    )
    axes.set_title(f"{view.time[k] - view.takeover_time:.1f} s   {graph}", loc="left", fontsize=9)
