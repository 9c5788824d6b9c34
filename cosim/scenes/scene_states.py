"""The states of a scene file, computed from positions along lanes."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from cosim.scenes.clips import Clip
from cosim.scenes.scene_rules import DT
from cosim.scenes.trajectory_buffer import COLUMN, RoadSection
from gri.data.ngsim.integration import integrated


def road_positions(clips: Sequence[Clip], section: RoadSection) -> tuple[np.ndarray, np.ndarray]:
    """[S, N, M] Position s of the front bumper along the road, and lateral position d of the vehicle's lane [m]."""
    lane, position = (np.stack([clip.values[..., COLUMN[name]] for clip in clips]) for name in ("lane", "position"))
    xy = np.zeros((*lane.shape, 2))
    for index in np.unique(lane):
        on = lane == index
        xy[on] = section.lanes[int(index)].points(position[on])
    s, d = section.road.to_road(xy.reshape(-1, 2))
    return s.reshape(lane.shape), d.reshape(lane.shape)


def scene_features(
    s: Float[np.ndarray, "S N M"],
    d: Float[np.ndarray, "S N M"],
    v: Float[np.ndarray, "S N M"],
    dt: float,
    lane_change_time: float,
) -> dict[str, np.ndarray]:
    """State features [S, N, M − 1] of a scene file by name, SI units.

    SUMO moves a vehicle by its new speed, x' = x + v'·h with h = `dt`, so that its positions belong to speeds half a
    step later. The file has x = s − v·h/2 beside v. It obeys x' = x + (v + v')·h/2, which is the point mass of the
    paper. a is the acceleration until the next step, as in the paper's dynamics. SUMO changes lanes in one step; in the
    file a lane change takes `lane_change_time` [s] from then on.
    """
    x, a = s - v * dt / 2, np.diff(v) / DT
    lateral = np.concatenate([d[..., :-1], d[..., -2:-1]], -1)  # without a lane change after the last step
    y = _smooth_lane_changes(lateral, round(lane_change_time / DT))
    vy = np.gradient(y, DT, axis=-1)
    y, ay = integrated(vy, y, DT)
    heading = np.where(v > 0.5, np.arctan2(vy, np.maximum(v, 0.5)), 0.0)
    motion = {"x": x, "y": y, "vx": v, "vy": vy, "ay": ay, "v": v, "heading": heading}
    return {name: of[..., :-1] for name, of in motion.items()} | {
        "ax": a,
        "a": a,
        "yaw_rate": np.diff(heading) / DT,
    }


def _smooth_lane_changes(d: Float[np.ndarray, "S N M"], steps: int) -> Float[np.ndarray, "S N M"]:
    """d with every jump of more than 1 m spread over `steps` steps, along the path of least jerk."""
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
