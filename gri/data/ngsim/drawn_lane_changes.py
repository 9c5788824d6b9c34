"""Lane changes for training where recorded ones are few: recorded motion along the road, drawn motion across it.

Three vehicles that followed each other for T steps get lanes: the one that becomes vehicle 0 comes from a lane beside
the others along a logistic curve, all wander about their path. How fast and where it changes is drawn, so that such
scenes teach how a lane change looks and not when drivers choose to make one. They are never for testing, and their
source says what they are.
"""

import numpy as np

from gri.data.ngsim.integration import integrated

WIDTH = 3.66
"""Of a lane [m]."""
DURATION = (3.0, 6.0)
"""Time in which 5 to 95 % of the way across is done [s]; uniform."""
WANDER = 0.12
"""Amplitude of each of two slow waves about the path [m]."""
PERIOD = (8.0, 20.0)
"""Of the waves [s]."""
PLACES = {"H1": (0, 1, 2), "H2": (1, 0, 2)}
"""Which of the three, from the back, become vehicles 0, 1 and 2."""
OFFSET = 0.3
"""Standard deviation of where in its lane a vehicle drives [m]: in US-101's car-following scenes for training, mean
lateral positions of vehicles behind one another differ by 0.41 to 0.45 m.
"""
MARK = ", lateral motion drawn"
"""Added to the source's name."""


def lateral(
    count: int, steps: int, dt: float, crossing: tuple[int, int], generator: np.random.Generator
) -> dict[str, np.ndarray]:
    """y, vy, ay [S, 3, T] of scenes in which vehicle 0 changes to the lane at y = 0, from either side."""
    time = np.arange(steps) * dt
    waves = np.zeros((count, 3, steps))
    for _ in range(2):
        period = generator.uniform(*PERIOD, (count, 3, 1))
        waves += WANDER * np.sin(2 * np.pi * time / period + generator.uniform(0, 2 * np.pi, (count, 3, 1)))
    side = generator.choice([-1.0, 1.0], (count, 1))
    middle = generator.uniform(*crossing, (count, 1)) * dt
    scale = generator.uniform(*DURATION, (count, 1)) / (2 * np.log(19.0))
    path = waves + OFFSET * generator.standard_normal((count, 3, 1))
    path[:, 0] += side * WIDTH / (1 + np.exp((time - middle) / scale))
    v = np.asarray(np.gradient(path, dt, axis=-1))
    y, a = integrated(v, path, dt)
    return {"y": y, "vy": v, "ay": a}
