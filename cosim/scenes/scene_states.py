"""From positions along lanes to the states of a scene file."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from cosim.scenes.clips import Clip
from cosim.scenes.rules import DT
from cosim.scenes.trajectory_buffer import COLUMN, RoadSection
from gri.data.ngsim.integration import integrated


def places(clips: Sequence[Clip], stretch: RoadSection) -> tuple[np.ndarray, np.ndarray]:
    """[S, 3, M] s of the front bumper and lateral position d of the lane each vehicle is on [m]."""
    lane, position = (np.stack([clip.values[..., COLUMN[name]] for clip in clips]) for name in ("lane", "position"))
    xy = np.zeros((*lane.shape, 2))
    for index in np.unique(lane):
        on = lane == index
        xy[on] = stretch.lanes[int(index)].points(position[on])
    s, d = stretch.road.to_road(xy.reshape(-1, 2))
    return s.reshape(lane.shape), d.reshape(lane.shape)


def features(
    s: Float[np.ndarray, "S N M"],
    d: Float[np.ndarray, "S N M"],
    v: Float[np.ndarray, "S N M"],
    step: float,
    sideways: float,
) -> dict[str, np.ndarray]:
    """States of the M − 1 steps of a scene file, SI units.

    SUMO moves a vehicle by its new speed, x' = x + v'·h, so that its positions belong to speeds half a step h later.
    The file's x = s − v·h/2 goes with v: it obeys x' = x + (v + v')·h/2, the point mass of the paper. a is the
    acceleration from there on, as in the paper's dynamics. Lane changes take `sideways` [s] from where SUMO makes them.
    """
    x, a = s - v * step / 2, np.diff(v) / DT
    seen = np.concatenate([d[..., :-1], d[..., -2:-1]], -1)  # a change after the last step does not show
    y = _sideways(seen, round(sideways / DT))
    vy = np.gradient(y, DT, axis=-1)
    y, ay = integrated(vy, y, DT)
    heading = np.where(v > 0.5, np.arctan2(vy, np.maximum(v, 0.5)), 0.0)
    motion = {"x": x, "y": y, "vx": v, "vy": vy, "ay": ay, "v": v, "heading": heading}
    return {name: of[..., :-1] for name, of in motion.items()} | {
        "ax": a,
        "a": a,
        "yaw_rate": np.diff(heading) / DT,
    }


def _sideways(d: Float[np.ndarray, "S N M"], steps: int) -> Float[np.ndarray, "S N M"]:
    """The same, with every jump of more than a metre spread over so many steps: the path of least jerk."""
    if steps <= 1:
        return d
    jump = np.diff(d, axis=-1, prepend=d[..., :1])
    jump = np.where(np.abs(jump) > 1.0, jump, 0.0)
    path = d - np.cumsum(jump, -1)
    u = np.clip(np.arange(d.shape[-1]) / steps, 0.0, 1.0)
    course = u**3 * (10 - 15 * u + 6 * u**2)
    for scene, vehicle, t in np.argwhere(jump).tolist():
        path[scene, vehicle, t:] += jump[scene, vehicle, t] * course[1 : d.shape[-1] - t + 1]
    return path
