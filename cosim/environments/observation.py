"""What a learner observes of its group: numbers near 1 from the states that every policy gets.

The same function serves the environments and `LearnedPolicy`, so a policy meets in a run what it met in training.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gri.core.dynamics import Dynamics

LARGEST = 10.0
"""Observations are clipped to ±LARGEST, so that their space is bounded."""
_UNITS = {"x": 30.0, "y": 4.0, "v": 15.0, "heading": 0.2, "a": 3.0, "yaw_rate": 0.2}
_SPEED_DIFFERENCE = 5.0  # [m/s]


@dataclass(frozen=True)
class Feature:
    """One number of an observation: a state feature of the `vehicle` in `unit`, less that of the observer or not."""

    vehicle: int
    state: str
    unit: float
    relative: bool


def features_of(role: int, dynamics: Dynamics) -> tuple[Feature, ...]:
    """The features that the driver of a role observes.

    Of its own vehicle: all of the state but x. Of both others, in the order of their roles: x and v relative to its
    own, y in a merge, and a.
    """
    own = [Feature(role, name, _UNITS[name], False) for name in dynamics.state if name != "x"]
    shown = [name for name in ("x", "y", "v", "a") if name in dynamics.state]
    others = [
        Feature(other, name, _SPEED_DIFFERENCE if name == "v" else _UNITS[name], relative=name in ("x", "v"))
        for other in range(3)
        if other != role
        for name in shown
    ]
    return (*own, *others)


def observe(states: Float[np.ndarray, "*batch 3 D"], role: int, dynamics: Dynamics) -> Float[np.ndarray, "*batch F"]:
    """The observation of a role in float32."""
    features = features_of(role, dynamics)
    vehicles = [feature.vehicle for feature in features]
    columns = [dynamics.index(feature.state) for feature in features]
    own = np.where([feature.relative for feature in features], states[..., role, columns], 0.0)
    values = (states[..., vehicles, columns] - own) / np.array([feature.unit for feature in features])
    return np.clip(values, -LARGEST, LARGEST).astype(np.float32)
