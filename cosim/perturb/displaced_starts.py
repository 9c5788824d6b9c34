"""Displaced starts, and which of them are feasible: pure functions of one group and the traffic around it.

Boxes are taken along the road here: at the take-over vehicles drive along their lanes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from cosim.spec.perturbations import HeadwayMetres, HeadwayRatio, Perturbation, RemoveThird, SpeedOffset

BRAKING = 8.0  # [m/s^2], what a vehicle can do at most on a dry road


class Infeasible(StrEnum):
    """Why a start is excluded."""

    OVERLAP = "overlap"  # a displaced vehicle stands in another one
    OFF_ROAD = "off_road"  # a displaced vehicle stands outside the road or its lane
    ORDER = "order"  # in one lane a follower can only be behind its leader, with nobody in between
    UNAVOIDABLE = "unavoidable"  # not even braking with BRAKING from the first instant on avoids contact
    NO_NEIGHBOUR = "no_neighbour"  # nobody is there who could cut in


@dataclass(frozen=True)
class Cars:
    """Vehicles at one instant in the road frame: front bumpers, speeds, sizes [m, m/s]."""

    s: Float[np.ndarray, " V"]
    d: Float[np.ndarray, " V"]
    v: Float[np.ndarray, " V"]
    length: Float[np.ndarray, " V"]
    width: Float[np.ndarray, " V"]

    def __getitem__(self, rows: Bool[np.ndarray, " V"] | slice) -> "Cars":
        return Cars(self.s[rows], self.d[rows], self.v[rows], self.length[rows], self.width[rows])


@dataclass(frozen=True)
class Rule:
    """What the group rule says about headways: who follows whom, in one lane from the rear to the front or not.

    `pair` is (follower, leader), `left` the pair that is left when vehicle 2 is removed.
    """

    pair: tuple[int, int]
    left: tuple[int, int]
    one_lane: bool


CAR_FOLLOWING = Rule(pair=(0, 1), left=(0, 1), one_lane=True)
MERGE = Rule(pair=(0, 2), left=(1, 0), one_lane=False)


def displaced(group: Cars, perturbations: Sequence[Perturbation], rule: Rule) -> Cars:
    """The group (roles 0, 1, 2) as its start is perturbed."""
    s, v = group.s.copy(), group.v.copy()
    for perturbation in perturbations:
        match perturbation:
            case HeadwayRatio(intensity=ratio):
                _shift(s, rule.pair, ratio)
            case RemoveThird(intensity=ratio):
                _shift(s, rule.left, ratio)
            case HeadwayMetres(intensity=metres):
                s[rule.pair[0]] += metres
            case SpeedOffset(intensity=faster):
                v[0] = max(v[0] + faster, 0.0)
    return replace(group, s=s, v=v)


def _shift(s: Float[np.ndarray, " 3"], pair: tuple[int, int], ratio: float) -> None:
    """Δx' = (1 − δ)·Δx."""
    follower, leader = pair
    s[follower] += ratio * (s[leader] - s[follower])


def verdict(
    before: Cars,
    after: Cars,
    others: Cars,
    *,
    present: Bool[np.ndarray, " 3"],
    span: Float[np.ndarray, "3 2"],
    rule: Rule,
    braking: float = BRAKING,
) -> Infeasible | None:
    """Why the start `after` is infeasible, if it is.

    `others` are the vehicles around the group, `present` says which of the group are still there, `span` [m] where
    along the road each of the three can be with its front.
    """
    moved = present & ((before.s != after.s) | (before.v != after.v))
    if not moved.any():
        return None
    if ((after.s < span[:, 0]) | (after.s > span[:, 1]))[moved].any():
        return Infeasible.OFF_ROAD
    group = after[present]
    everyone = Cars(*(np.concatenate(pair) for pair in zip(_columns(group), _columns(others), strict=True)))
    concerned = np.concatenate([moved[present], np.zeros(len(others.s), dtype=bool)])
    if rule.one_lane and not _in_order(group, others):
        return Infeasible.ORDER if not _overlap(everyone, concerned) else Infeasible.OVERLAP
    if _overlap(everyone, concerned):
        return Infeasible.OVERLAP
    return Infeasible.UNAVOIDABLE if _unavoidable(everyone, concerned, braking) else None


def _columns(cars: Cars) -> tuple[np.ndarray, ...]:
    return cars.s, cars.d, cars.v, cars.length, cars.width


def _beside(cars: Cars) -> Bool[np.ndarray, "V V"]:
    """Whose strips across the road overlap."""
    apart = np.abs(cars.d[:, None] - cars.d[None]) >= 0.5 * (cars.width[:, None] + cars.width[None])
    return ~apart & ~np.eye(len(cars.s), dtype=bool)


def _overlap(cars: Cars, concerned: Bool[np.ndarray, " V"]) -> bool:
    rear = cars.s - cars.length
    along = (rear[:, None] < cars.s[None]) & (rear[None] < cars.s[:, None])
    return bool((_beside(cars) & along)[concerned].any())


def _in_order(group: Cars, others: Cars) -> bool:
    """Whether the group goes on in its order along its lane, with nobody in between."""
    same = np.abs(others.d - group.d[0]) < 0.5 * (others.width + group.width[0])
    fronts = others.s[same]
    return all(
        behind < ahead and not ((fronts > behind) & (fronts < ahead)).any() for behind, ahead in pairwise(group.s)
    )


def _unavoidable(cars: Cars, concerned: Bool[np.ndarray, " V"], braking: float) -> bool:
    """Whether any pair with a concerned vehicle meets though the one behind brakes and the one ahead keeps its speed.

    The gap closes by (v_i − v_j)²/(2b) before the speeds are the same.
    """
    gap = cars.s[None] - cars.length[None] - cars.s[:, None]  # Shape: (behind, ahead)
    closing = np.maximum(cars.v[:, None] - cars.v[None], 0.0)
    behind = _beside(cars) & (cars.s[None] > cars.s[:, None])
    meets = behind & (closing**2 / (2 * braking) > gap)
    return bool(meets[concerned].any() or meets[:, concerned].any())


def hits_ahead(gap: float, v: float, ahead: Float[np.ndarray, " T"], dt: float, braking: float = BRAKING) -> bool:
    """Whether a vehicle that brakes from the first instant on meets one ahead that has these speeds, every dt.

    `gap` [m] is the net gap at the first of them, `v` [m/s] the speed of the vehicle behind; both move uniformly
    accelerated between the instants.
    """
    own = np.maximum(v - braking * dt * np.arange(len(ahead)), 0.0)
    difference = ahead - own
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * dt * (difference[1:] + difference[:-1]))])
    return bool((gap + travelled < 0).any())
