"""Displaced starts and their feasibility: pure functions of one group and the traffic around it.

The vehicles' boxes are aligned with the road here, because at the take-over vehicles drive along their lanes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from cosim.perturb.reference_manoeuvres import VehicleStates, can_be_avoided
from cosim.spec.perturbations import HeadwayMetres, HeadwayRatio, Perturbation, RemoveThird, SpeedOffset

BRAKING = 8.0  # [m/s^2], the hardest braking of a vehicle on a dry road


class Infeasible(StrEnum):
    """Why a start is excluded."""

    OVERLAP = "overlap"  # a displaced vehicle overlaps another one
    OFF_ROAD = "off_road"  # a displaced vehicle is outside the road or its lane
    ORDER = "order"  # in one lane a follower must be behind its leader, with no vehicle in between
    UNAVOIDABLE = "unavoidable"  # no reference driver avoids a contact that begins in the first second
    NO_NEIGHBOUR = "no_neighbour"  # no vehicle is there that could cut in


@dataclass(frozen=True)
class HeadwayRule:
    """The headways of a group that perturbations change, by roles.

    `pair` is the (follower, leader) of the perturbed headway, `pair_without_third` that when vehicle 2 is removed.
    `one_lane` says whether the group drives in one lane, in the order of its roles from the rear to the front.
    """

    pair: tuple[int, int]
    pair_without_third: tuple[int, int]
    one_lane: bool


CAR_FOLLOWING = HeadwayRule(pair=(0, 1), pair_without_third=(0, 1), one_lane=True)
MERGE = HeadwayRule(pair=(0, 2), pair_without_third=(1, 0), one_lane=False)


def displaced(group: VehicleStates, perturbations: Sequence[Perturbation], rule: HeadwayRule) -> VehicleStates:
    """The group with its perturbed start."""
    s, v = group.s.copy(), group.v.copy()
    for perturbation in perturbations:
        match perturbation:
            case HeadwayRatio(intensity=ratio):
                _shorten(s, rule.pair, ratio)
            case RemoveThird(intensity=ratio):
                _shorten(s, rule.pair_without_third, ratio)
            case HeadwayMetres(intensity=metres):
                s[rule.pair[0]] += metres
            case SpeedOffset(intensity=offset):
                v[0] = max(v[0] + offset, 0.0)
    return replace(group, s=s, v=v)


def _shorten(s: Float[np.ndarray, " N"], pair: tuple[int, int], ratio: float) -> None:
    """Shorten a headway in place: Δx' = (1 − δ)·Δx."""
    follower, leader = pair
    s[follower] += ratio * (s[leader] - s[follower])


def infeasibility(
    before: VehicleStates,
    after: VehicleStates,
    others: VehicleStates,
    *,
    present: Bool[np.ndarray, " N"],
    span: Float[np.ndarray, "N 2"],
    rule: HeadwayRule,
    braking: float = BRAKING,
    driven: Sequence[int] = (0, 1),
    sides: tuple[float, float] | None = None,
) -> Infeasible | None:
    """Why the start `after` is infeasible; None where it is feasible.

    `others` are the vehicles around the group. `present` says which vehicles of the group are not removed. `span` [m]
    is the range of s in which each of its vehicles can be, `braking` [m/s²] the hardest possible braking. The
    policy drives the roles in `driven`, which are present. `sides` is the range of d [m] of the road; None where
    vehicles cannot leave their lane.
    """
    moved = present & ((before.s != after.s) | (before.v != after.v))
    if not moved.any():
        return None
    if ((after.s < span[:, 0]) | (after.s > span[:, 1]))[moved].any():
        return Infeasible.OFF_ROAD
    group = after[present]
    everyone = VehicleStates(*(np.concatenate(pair) for pair in zip(_columns(group), _columns(others), strict=True)))
    concerned = np.concatenate([moved[present], np.zeros(len(others.s), dtype=bool)])
    if rule.one_lane and not _in_order(group, others):
        return Infeasible.ORDER if not _overlap(everyone, concerned) else Infeasible.OVERLAP
    if _overlap(everyone, concerned):
        return Infeasible.OVERLAP
    return None if can_be_avoided(everyone, concerned, driven, braking, sides) else Infeasible.UNAVOIDABLE


def _columns(states: VehicleStates) -> tuple[np.ndarray, ...]:
    return states.s, states.d, states.v, states.length, states.width


def _overlap(states: VehicleStates, concerned: Bool[np.ndarray, " V"]) -> bool:
    """Whether a concerned vehicle overlaps any other one."""
    rear, own = states.s - states.length, np.flatnonzero(concerned)
    along = (rear[own, None] < states.s) & (rear < states.s[own, None])  # Shape: (own, V)
    apart = np.abs(states.d[own, None] - states.d) >= 0.5 * (states.width[own, None] + states.width)
    return bool((along & ~apart & (own[:, None] != np.arange(len(states.s)))).any())


def _in_order(group: VehicleStates, others: VehicleStates) -> bool:
    """Whether the group keeps its order along its lane, with no other vehicle in between."""
    same = np.abs(others.d - group.d[0]) < 0.5 * (others.width + group.width[0])
    fronts = others.s[same]
    return all(
        behind < ahead and not ((fronts > behind) & (fronts < ahead)).any() for behind, ahead in pairwise(group.s)
    )


def collides_despite_braking(
    gap: float, v: float, v_leader: Float[np.ndarray, " T"], dt: float, braking: float = BRAKING
) -> bool:
    """Whether a follower that brakes from the first instant on collides with its leader.

    `gap` [m] is the net gap at the first instant, `v` [m/s] the follower's speed then, `v_leader` [m/s] the leader's
    speed every `dt` [s]. Accelerations are constant between the instants.
    """
    v_follower = np.maximum(v - braking * dt * np.arange(len(v_leader)), 0.0)
    difference = v_leader - v_follower
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * dt * (difference[1:] + difference[:-1]))])
    return bool((gap + travelled < 0).any())
