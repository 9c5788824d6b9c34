"""What a learner observes: numbers near 1 from what every policy may see.

Two kinds: the states of its "group", or of "everybody": then also the nearest other vehicles in and beside its path,
and where its lane ends. The same function serves the environments and `LearnedPolicy`, so a policy meets in a run what
it met in training.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Bool, Float

from cosim.world.road_frame import NOMINAL_LENGTH
from gri.core.dynamics import Dynamics
from gri.core.nearby import OWN_WIDTH, Nearby
from gri.errors import InputError

ObservationKind = Literal["group", "everybody"]
LARGEST = 10.0
"""Observations are clipped to ±LARGEST, so that their space is bounded."""
_UNITS = {"x": 30.0, "y": 4.0, "v": 15.0, "heading": 0.2, "a": 3.0, "yaw_rate": 0.2}
_SPEED_DIFFERENCE = 5.0  # [m/s]
_GAP = 30.0  # [m]
_LANE_LEFT = 100.0  # [m]
_NOBODY = 100.0  # [m], the gap where nobody is in reach
_MARGIN = 0.3  # [m] across; with less, two vehicles are in each other's path
_BESIDE = 5.5  # [m] between the centres of vehicles in lanes side by side, at most
_PLACES = tuple((lane, end) for lane in ("path", "left", "right") for end in ("ahead", "behind"))


@dataclass(frozen=True)
class Feature:
    """One number of an observation: a state feature of the `vehicle` in `unit`, less that of the observer or not."""

    vehicle: int
    state: str
    unit: float
    relative: bool


def check_seen(kind: str) -> None:
    """Raise `InputError` for a kind of observation that does not exist."""
    if kind not in get_args(ObservationKind):
        raise InputError(f"sees: got {kind!r}, expected one of {', '.join(get_args(ObservationKind))}")


def features_of(role: int, dynamics: Dynamics) -> tuple[Feature, ...]:
    """The features of its group that the driver of a role observes.

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


def names_of(role: int, dynamics: Dynamics, sees: ObservationKind) -> tuple[str, ...]:
    """The names of all numbers of an observation, in their order, such as "2.x" and "path.ahead.gap"."""
    group = [f"{feature.vehicle}.{feature.state}" for feature in features_of(role, dynamics)]
    if sees == "group":
        return tuple(group)
    around = [f"{lane}.{end}.{what}" for lane, end in _PLACES for what in ("gap", "v")]
    return (*group, *(["lane_left"] if "y" in dynamics.state else []), *around)


def observe(
    states: Float[np.ndarray, "*batch 3 D"], role: int, dynamics: Dynamics, nearby: Nearby | None = None
) -> Float[np.ndarray, "*batch F"]:
    """The observation of a role in float32: of its group, or of everybody with those who are `nearby`."""
    features = features_of(role, dynamics)
    vehicles = [feature.vehicle for feature in features]
    columns = [dynamics.index(feature.state) for feature in features]
    own = np.where([feature.relative for feature in features], states[..., role, columns], 0.0)
    values = (states[..., vehicles, columns] - own) / np.array([feature.unit for feature in features])
    if nearby is not None:
        values = np.concatenate([values, _around(states, role, dynamics, nearby)], axis=-1)
    return np.clip(values, -LARGEST, LARGEST).astype(np.float32)


def _around(
    states: Float[np.ndarray, "B 3 D"], role: int, dynamics: Dynamics, nearby: Nearby
) -> Float[np.ndarray, "B F"]:
    """Where the lane ends, and the nearest vehicle in each of `_PLACES`: its net gap and relative speed."""
    found = []
    if "y" in dynamics.state:
        left = torch.full(states.shape[:1], _LANE_LEFT * LARGEST)
        found.append((left if nearby.lane_left is None else nearby.lane_left[:, role]) / _LANE_LEFT)
    ahead, across = nearby.ahead[:, role], nearby.across[:, role]
    in_path = across.abs() < 0.5 * (nearby.width + OWN_WIDTH) + _MARGIN
    lanes = {"path": in_path, "left": ~in_path & (across > 0), "right": ~in_path & (across < 0)}
    gaps = {"ahead": ahead - nearby.length, "behind": -ahead - NOMINAL_LENGTH}
    speed = nearby.v - torch.from_numpy(states[:, role, dynamics.index("v")].astype(np.float32))[:, None]
    close = nearby.present & (across.abs() < _BESIDE)
    for lane, end in _PLACES:
        there = close & lanes[lane] & ((ahead > 0) if end == "ahead" else (ahead <= 0))
        found += _nearest(gaps[end], speed, there)
    return torch.stack(found, -1).numpy()


def _nearest(
    gap: Float[torch.Tensor, "B M"], speed: Float[torch.Tensor, "B M"], there: Bool[torch.Tensor, "B M"]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Gap and relative speed of the nearest one, as numbers near 1."""
    nobody = gap.new_full((len(gap), 1), _NOBODY)  # one more vehicle, far off at the same speed
    gaps = torch.cat([torch.where(there, gap, torch.inf), nobody], -1)
    nearest, which = gaps.min(-1)
    speeds = torch.cat([speed, torch.zeros_like(nobody)], -1)
    return nearest / _GAP, speeds.gather(1, which[:, None])[:, 0] / _SPEED_DIFFERENCE
