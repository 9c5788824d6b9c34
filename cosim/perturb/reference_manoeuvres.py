"""Whether any of several reference drivers gets through the first second after a start; pure and vectorised.

A formula for braking alone does not see a vehicle that comes from behind: SUMO's drivers go on for .6 to .8 s before
they react to a vehicle that was put in front of them. Boxes are aligned with the road.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

FIRST_SECOND, STEP = 1.0, 0.1  # [s]
LATERAL = 3.0  # [m/s²], lateral acceleration of a driver that steers away
MAX_SLOPE = 0.3  # greatest lateral speed as a share of the speed
REACH = 80.0  # [m] along the road, within which vehicles matter in this second


@dataclass(frozen=True)
class VehicleStates:
    """Vehicles at one instant in the road frame: front bumpers (s, d) [m], speeds v [m/s], sizes [m]."""

    s: Float[np.ndarray, " V"]
    d: Float[np.ndarray, " V"]
    v: Float[np.ndarray, " V"]
    length: Float[np.ndarray, " V"]
    width: Float[np.ndarray, " V"]

    def __getitem__(self, rows: Bool[np.ndarray, " V"] | Int[np.ndarray, " R"]) -> "VehicleStates":
        return VehicleStates(self.s[rows], self.d[rows], self.v[rows], self.length[rows], self.width[rows])


def can_be_avoided(
    states: VehicleStates,
    moved: Bool[np.ndarray, " V"],
    driven: Sequence[int],
    braking: float,
    sides: tuple[float, float] | None,
) -> bool:
    """Whether some choice of manoeuvres of the driven vehicles avoids every contact that a displacement would cause.

    Each driven vehicle holds its lateral position or steers to the left or the right, and keeps its speed or brakes as
    hard as it can. All other vehicles keep their speeds and places in the lane. A choice succeeds if no moved or driven
    vehicle is in contact within the first second, and if then braking by the vehicle behind, while the one ahead keeps
    its speed, avoids a contact: the gap closes by (v_i − v_j)²/(2b) before the speeds are the same. Two vehicles that
    were not moved, and would come into contact if both kept their speeds, do not count: their drivers see each other.

    Args:
        states: all vehicles.
        moved: the displaced vehicles.
        driven: rows of the vehicles that a policy drives.
        braking: the hardest possible deceleration b [m/s²], which steering and braking share.
        sides: the range of d [m] of the road; None where vehicles cannot leave their lane.
    """
    own = np.union1d(np.flatnonzero(moved), np.asarray(driven, dtype=int))
    rows = np.flatnonzero((np.abs(states.s[:, None] - states.s[own]) < REACH).any(axis=1))
    states, moved, own, moving = states[rows], moved[rows], np.searchsorted(rows, own), np.searchsorted(rows, driven)
    steering = (0.0,) if sides is None else (0.0, 1.0, -1.0)
    choices = np.array([*product(product((0.0, 1.0), steering), repeat=len(driven))])  # Shape: (choice, driven, 2)
    s, d, v, on_road = _rolled_out(states, moving, choices, braking, sides)
    collide = _in_contact(s, d, states, own).any(axis=1) | _collide_despite_braking(s, d, v, states, own, braking)
    counts = moved[own, None] | moved | ~collide[0]  # the first choice is that all keep their speeds
    return bool((on_road & ~(collide & counts).any(axis=(1, 2))).any())


def _rolled_out(
    states: VehicleStates,
    moving: Int[np.ndarray, " M"],
    choices: Float[np.ndarray, "C M 2"],
    braking: float,
    sides: tuple[float, float] | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Bool[np.ndarray, " C"]]:
    """Positions s, d and speeds v of shape (C, T, V) for each choice, and whether its vehicles stay on the road."""
    time = np.arange(0, FIRST_SECOND + 1e-9, STEP)
    count = (len(choices), len(time), len(states.s))
    s = np.broadcast_to(states.s + states.v * time[:, None], count).copy()
    d, v = (np.broadcast_to(x, count).copy() for x in (states.d, states.v))
    brakes, side = choices[..., 0], choices[..., 1]
    lateral = min(LATERAL, braking / 2) * np.abs(side)
    deceleration = (np.sqrt(braking**2 - lateral**2) * brakes)[:, None]  # Shape: (C, 1, M), of the friction circle
    stop = np.minimum(time[:, None], states.v[moving] / np.maximum(deceleration, 1e-9))
    s[..., moving] = states.s[moving] + states.v[moving] * stop - 0.5 * deceleration * stop**2
    s[..., moving] += np.where(deceleration > 0, 0.0, states.v[moving] * (time[:, None] - stop))
    v[..., moving] = states.v[moving] - deceleration * stop
    sideways = np.minimum(lateral[:, None] * time[:, None], MAX_SLOPE * v[..., moving])
    covered = np.cumsum(0.5 * STEP * (sideways[:, 1:] + sideways[:, :-1]), axis=1)
    d[:, 1:, moving] += side[:, None] * covered
    if sides is None:
        return s, d, v, np.ones(len(choices), dtype=bool)
    half, last = 0.5 * states.width[moving], d[:, -1, moving]
    steers = side != 0
    outside = (last - half < sides[0]) | (last + half > sides[1])
    return s, d, v, ~(outside & steers).any(axis=1)


def _in_contact(
    s: Float[np.ndarray, "C T V"], d: Float[np.ndarray, "C T V"], states: VehicleStates, own: Int[np.ndarray, " M"]
) -> Bool[np.ndarray, "C T M V"]:
    """Whether the boxes of each own and each other vehicle overlap."""
    rear = s - states.length
    along = (rear[..., own, None] < s[..., None, :]) & (rear[..., None, :] < s[..., own, None])
    return along & _in_path(d, states, own)


def _in_path(d: Float[np.ndarray, "*C V"], states: VehicleStates, own: Int[np.ndarray, " M"]) -> np.ndarray:
    """Whether the widths of each own and each other vehicle overlap; a vehicle is not in its own path."""
    beside = np.abs(d[..., own, None] - d[..., None, :]) >= 0.5 * (states.width[own, None] + states.width)
    return ~beside & (own[:, None] != np.arange(len(states.s)))


def _collide_despite_braking(
    s: Float[np.ndarray, "C T V"],
    d: Float[np.ndarray, "C T V"],
    v: Float[np.ndarray, "C T V"],
    states: VehicleStates,
    own: Int[np.ndarray, " M"],
    braking: float,
) -> Bool[np.ndarray, "C M V"]:
    """Whether the rear one of two vehicles runs into the other although it brakes from the last instant on."""
    s, v = s[:, -1], v[:, -1]
    ahead = s[:, None, :] > s[:, own, None]  # the other one
    front = np.where(ahead, s[:, None, :] - states.length, s[:, own, None] - states.length[own, None])
    gap = front - np.where(ahead, s[:, own, None], s[:, None, :])
    closing = np.where(ahead, 1, -1) * (v[:, own, None] - v[:, None, :])
    return (np.maximum(closing, 0.0) ** 2 / (2 * braking) > gap) & _in_path(d[:, -1], states, own)
