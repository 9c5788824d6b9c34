"""Lane changes for training: recorded longitudinal motion with sampled lateral motion.

Recorded lane changes are few. So three vehicles that followed each other for T steps get sampled lateral positions:
vehicle 0 comes from an adjacent lane along a logistic curve, and all three wander slowly about their paths. The time
and duration of the change are random. Such scenes therefore teach what a lane change looks like, but not when drivers
decide to make one. They are for training only, and the name of their source ends in `SOURCE_SUFFIX`.
"""

import numpy as np

from gri.data.ngsim.integration import integrated

LANE_WIDTH = 3.66
"""Width of a lane [m]."""
CROSSING_DURATION = (3.0, 6.0)
"""Range of the time from 5 % to 95 % of the lateral displacement [s]; uniform."""
WANDER_AMPLITUDE = 0.12
"""Amplitude of each of two slow waves about the path [m]."""
WANDER_PERIOD = (8.0, 20.0)
"""Range of the periods of these waves [s]; uniform."""
VEHICLE_ORDER = {"H1": (0, 1, 2), "H2": (1, 0, 2)}
"""Place in the triple, counted from the back, of vehicles 0, 1 and 2, by hypothesis."""
LANE_OFFSET_STD = 0.3
"""Standard deviation of a vehicle's mean lateral position in its lane [m].

In US-101's car-following scenes for training, mean lateral positions of successive vehicles differ by 0.41 to 0.45 m.
"""
SOURCE_SUFFIX = ", lateral motion drawn"
"""Ending of the source's name in the scene file."""


def sample_lateral_motion(
    count: int, steps: int, dt: float, crossing: tuple[int, int], generator: np.random.Generator
) -> dict[str, np.ndarray]:
    """Sampled y [m], vy [m/s] and ay [m/s²], each [S, 3, T], for S = `count` scenes of T = `steps` steps of `dt` [s].

    Vehicle 0 changes from either side to the lane at y = 0. Its path is halfway at a step of the range `crossing`.
    """
    time = np.arange(steps) * dt
    waves = np.zeros((count, 3, steps))
    for _ in range(2):
        period = generator.uniform(*WANDER_PERIOD, (count, 3, 1))
        waves += WANDER_AMPLITUDE * np.sin(2 * np.pi * time / period + generator.uniform(0, 2 * np.pi, (count, 3, 1)))
    side = generator.choice([-1.0, 1.0], (count, 1))
    middle = generator.uniform(*crossing, (count, 1)) * dt
    scale = generator.uniform(*CROSSING_DURATION, (count, 1)) / (2 * np.log(19.0))
    path = waves + LANE_OFFSET_STD * generator.standard_normal((count, 3, 1))
    path[:, 0] += side * LANE_WIDTH / (1 + np.exp((time - middle) / scale))
    v = np.asarray(np.gradient(path, dt, axis=-1))
    y, a = integrated(v, path, dt)
    return {"y": y, "vy": v, "ay": a}
