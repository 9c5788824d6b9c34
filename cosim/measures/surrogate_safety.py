"""Surrogate safety and comfort measures of one drive: pure functions of trajectories, SI units.

Trajectories are in the road frame of cosim/world/road_frame.py: `s` [m] of the front bumper along the road, `d` [m] to
the left. Vehicle i is *behind* j at an instant if s_i < s_j and their widths overlap, |d_i − d_j| < (w_i + w_j)/2.
Where no vehicle is behind another, measures of following are +inf (DRAC: 0). PET and the distance between vehicles use
oriented boxes (`cosim.measures.collision_detection`).

Sources: TTC Hayward (1972); DRAC Cooper and Ferguson (1976); PET Allen, Shin and Cooper (1978); SUMO doc: SSM Device.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from cosim.measures.collision_detection import Boxes, box_centre, boxes_overlap

BRAKING = (2.0, 3.0)  # [m/s²]; SUMO's drivers here brake with 3.5 at most unless there is an emergency
HARD_BRAKING = 4.5  # [m/s²]
JERK_QUANTILES = (0.5, 0.95, 0.99)
ROUNDING = 1e-6  # [m], more than distances are rounded by
PET_SUBSTEPS = 10  # of a step, between which poses are interpolated for PET

Times = Float[np.ndarray, " T"]


@dataclass(frozen=True)
class Track:
    """One vehicle over time; poses are front-bumper centres, `xy` and `heading` in the world frame."""

    time: Times
    s: Times
    d: Times
    v: Times
    a: Times
    xy: Float[np.ndarray, "T 2"]
    heading: Times
    length: float
    width: float

    def __getitem__(self, rows: Bool[np.ndarray, " T"] | slice) -> "Track":
        """The same vehicle at some of the instants."""
        time, s, d, v, a, heading = (x[rows] for x in (self.time, self.s, self.d, self.v, self.a, self.heading))
        return Track(time, s, d, v, a, self.xy[rows], heading, self.length, self.width)


def net_gap(
    s_follower: Float[np.ndarray, "*n"], s_leader: Float[np.ndarray, "*n"], length_leader: Float[np.ndarray, "*#n"]
) -> Float[np.ndarray, "*n"]:
    """Gap [m] from a follower's front bumper to its leader's rear bumper; negative when they overlap along the road."""
    return s_leader - length_leader - s_follower


def time_to_collision(
    gap: Float[np.ndarray, "*n"], v_follower: Float[np.ndarray, "*n"], v_leader: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """Time [s] until contact at constant speeds: gap / (v_follower − v_leader); +inf when the gap does not close."""
    closing = v_follower - v_leader
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(closing > 0, np.maximum(gap, 0) / closing, np.inf)


def behind(follower: Track, leader: Track) -> Bool[np.ndarray, " T"]:
    """At which instants the follower is behind the leader and in its path."""
    beside = np.abs(follower.d - leader.d) >= 0.5 * (follower.width + leader.width)
    return ~beside & (follower.s < leader.s)


def gap(follower: Track, leader: Track) -> Times:
    """Net gap [m], not below 0; +inf where the follower is not behind the leader."""
    distance = net_gap(follower.s, leader.s, np.array(leader.length))
    return np.where(behind(follower, leader), np.maximum(distance, 0.0), np.inf)


def ttc(follower: Track, leader: Track) -> Times:
    """Time to collision [s] at constant speeds, gap / (v_i − v_j); +inf where the gap does not close."""
    return time_to_collision(gap(follower, leader), follower.v, leader.v)


def drac(follower: Track, leader: Track) -> Times:
    """Deceleration rate to avoid a crash [m/s²]: (v_i − v_j)² / (2 gap), 0 where the gap does not close."""
    closing = np.maximum(follower.v - leader.v, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(closing > 0, closing**2 / (2 * gap(follower, leader)), 0.0)


def time_headway(follower: Track, leader: Track) -> Times:
    """Time [s] from front bumper to front bumper at the follower's speed: (s_j − s_i) / v_i."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(behind(follower, leader), (leader.s - follower.s) / follower.v, np.inf)


def pet(second: Track, first: Track, below: float = np.inf) -> float:
    """Post-encroachment time [s]: the shortest time after which the second vehicle is where the first one was.

    It is the smallest τ ≥ 0 such that the box of the second vehicle at some t + τ overlaps the box of the first one at
    t, with poses interpolated to PET_SUBSTEPS parts of a step; +inf if the second never drives where the first was. In
    car following this is the net time gap; at a crossing, the time from one vehicle leaving it to the other arriving.
    Only values smaller than `below` [s] are searched for; a larger one may be returned as +inf.
    """
    if (second.s - second.length > first.s + first.width).all() and (np.diff(second.s) >= 0).all():
        return np.inf  # the second was ahead all the time
    early, late = _interpolated_boxes(first), _interpolated_boxes(second)
    count, part = len(early.xy), float(first.time[1] - first.time[0]) / PET_SUBSTEPS
    for lag in range(0, count, PET_SUBSTEPS):
        if (lag - PET_SUBSTEPS) * part >= below:
            break
        if _overlap_after(late, early, lag):
            exact = next((k for k in range(max(lag - PET_SUBSTEPS, 0), lag) if _overlap_after(late, early, k)), lag)
            return exact * float(first.time[1] - first.time[0]) / PET_SUBSTEPS  # not · part: it rounds otherwise
    return np.inf


def _interpolated_boxes(track: Track) -> Boxes:
    """The boxes of one vehicle, PET_SUBSTEPS per step."""
    steps = np.arange(len(track.time))
    fine = np.linspace(steps[0], steps[-1], PET_SUBSTEPS * steps[-1] + 1)
    x, y, heading = (np.interp(fine, steps, value) for value in (*track.xy.T, np.unwrap(track.heading)))
    return _boxes_of(track, np.stack([x, y], axis=1), heading)


def _boxes_of(track: Track, xy: Float[np.ndarray, "U 2"], heading: Float[np.ndarray, " U"]) -> Boxes:
    return Boxes(xy, heading, np.full(len(xy), track.length), np.full(len(xy), track.width))


def _overlap_after(late: Boxes, early: Boxes, lag: int) -> bool:
    """Whether `late` at any instant overlaps `early` of `lag` substeps before; only close vehicles are tested."""
    count = len(early.xy) - lag
    reach = sum(float(boxes.length[0] + boxes.width[0]) for boxes in (late, early))  # each vehicle keeps its size
    apart = np.abs(late.xy[lag:] - early.xy[:count])
    near = (apart[:, 0] < reach) & (apart[:, 1] < reach)
    if not near.any():
        return False
    ours, theirs = (np.flatnonzero(near) + shift for shift in (lag, 0))
    return bool(boxes_overlap(late[ours], early[theirs]).any())


def box_distance(one: Track, other: Track) -> Times:
    """Distance [m] between the oriented boxes of two vehicles at each instant; 0 where they overlap."""
    a, b = _corners(one), _corners(other)
    apart = np.minimum(_corner_to_side(a, b), _corner_to_side(b, a))
    return np.where(
        boxes_overlap(_boxes_of(one, one.xy, one.heading), _boxes_of(other, other.xy, other.heading)), 0.0, apart
    )


def _corners(track: Track) -> Float[np.ndarray, "T 4 2"]:
    """The four corners of each box [m], in order around it."""
    centre = box_centre(track.xy, track.heading, np.full(len(track.time), track.length))
    forward = np.stack([np.cos(track.heading), np.sin(track.heading)], axis=1)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    corners = [
        centre + 0.5 * (u * track.length * forward + w * track.width * left)
        for u, w in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ]
    return np.stack(corners, axis=1)


def _corner_to_side(corners: Float[np.ndarray, "T 4 2"], box: Float[np.ndarray, "T 4 2"]) -> Times:
    """Smallest distance [m] from any corner of one box to any side of the other."""
    side = np.roll(box, -1, axis=1) - box
    offset = corners[:, :, None] - box[:, None]  # Shape: (T, corner, side, 2)
    share = (offset * side[:, None]).sum(-1) / (side**2).sum(-1)[:, None]
    nearest = np.clip(share, 0, 1)[..., None] * side[:, None]
    return np.linalg.norm(offset - nearest, axis=-1).min(axis=(1, 2))


def jerk(track: Track) -> Float[np.ndarray, " U"]:
    """Jerk [m/s³] between successive instants: Δa / Δt; one value fewer than instants."""
    return np.diff(track.a) / np.diff(track.time)


def brakings(track: Track, threshold: float = HARD_BRAKING) -> int:
    """Number of times the vehicle begins to brake harder than the threshold [m/s²]."""
    hard = track.a < -threshold
    return int(hard[0]) + int((hard[1:] & ~hard[:-1]).sum())


def lateral_change(one: Track, other: Track) -> float:
    """Δy [m] of the paper (Sec. VI-E): |y_1 − y_0| at the end minus at the start; negative if they come closer."""
    apart = np.abs(one.d - other.d)
    return float(apart[-1] - apart[0])


def effect_on(follower: Track) -> dict[str, float]:
    """Effect of a drive on the vehicle behind the group, from the first instant on.

    Keys: follower_min_acceleration [m/s²], the smallest one after the first instant; follower_speed_loss [m/s], the
    speed at the first instant minus the lowest speed.
    """
    return {
        "follower_min_acceleration": float(follower.a[1:].min(initial=np.inf)),
        "follower_speed_loss": float(follower.v[0] - follower.v.min()),
    }


def conflicts(members: Sequence[Track], driven: Sequence[int], others: Sequence[Track] = ()) -> dict[str, float]:
    """The worst value of each safety measure over all pairs in which a driven vehicle is the one behind.

    Args:
        members: the vehicles of the group.
        driven: which of them count as the one behind.
        others: parts of the tracks of vehicles outside the group, each without a break.

    Returns:
        Between members: min_gap [m] (net, along the road), min_ttc [s], max_drac [m/s²], min_pet [s], min_headway [s],
        and min_distance [m] (between boxes, wherever both are). The same without the headway, with `_to_others` behind
        the name, from driven vehicles to others. A pair counts at all instants at which both vehicles are present.
    """
    inside = [(members[i], member) for i in driven for j, member in enumerate(members) if i != j]
    outside = [(members[i], other) for i in driven for other in others]
    to_others = _worst(_common(outside))
    del to_others["min_headway"]
    return _worst(_common(inside)) | {f"{name}_to_others": value for name, value in to_others.items()}


def _common(pairs: Sequence[tuple[Track, Track]]) -> list[tuple[Track, Track]]:
    """The pairs at the instants at which both are present, without those that never are."""
    together = (_common_instants(i, j) for i, j in pairs)
    return [(i, j) for i, j in together if len(i.time)]


def _worst(pairs: Sequence[tuple[Track, Track]]) -> dict[str, float]:
    """The worst value of each measure over these pairs of (vehicle behind, vehicle ahead)."""
    min_pet = np.inf
    for i, j in pairs:
        if len(i.time) > 1 and _paths_may_cross(i, j):
            min_pet = min(min_pet, pet(i, j, below=min_pet))
    return {
        "min_gap": min((float(gap(i, j).min()) for i, j in pairs), default=np.inf),
        "min_ttc": min((float(ttc(i, j).min()) for i, j in pairs), default=np.inf),
        "max_drac": max((float(drac(i, j).max()) for i, j in pairs), default=0.0),
        "min_pet": min_pet,
        "min_headway": min((float(time_headway(i, j).min()) for i, j in pairs), default=np.inf),
        "min_distance": _least_distance(pairs),
    }


def _least_distance(pairs: Sequence[tuple[Track, Track]]) -> float:
    """The least `box_distance` [m] of all pairs: the nearest pairs first, without those that are too far apart."""
    least, bounds = np.inf, [_least_possible_distance(i, j) for i, j in pairs]
    for k in np.argsort(bounds):
        if bounds[k] < least:
            least = min(least, float(box_distance(*pairs[k]).min()))
    return least


def _least_possible_distance(one: Track, other: Track) -> float:
    """A distance [m] that the boxes never fall below: no point of a box is farther from its front than its diagonal."""
    apart = np.hypot(*(one.xy - other.xy).T).min()
    return float(apart) - ROUNDING - sum(math.hypot(track.length, track.width) for track in (one, other))


def _paths_may_cross(second: Track, first: Track) -> bool:
    """Whether the rectangles in the road frame that hold all places of each vehicle overlap; a fast test before `pet`.

    They are wider by 1 m and by what the rear of a vehicle swings out, because it may be at an angle to the road.
    """
    along = second.s.max() + second.width > (first.s - first.length).min() - first.width
    side = 0.5 * (second.width + first.width) + 1.0 + _swing(second) + _swing(first)
    across = second.d.min() - first.d.max() < side and first.d.min() - second.d.max() < side
    return bool(along and across)


def _swing(track: Track) -> float:
    """How far [m] the rear of a vehicle may be beside its front, from the direction in which it moves."""
    ds, dd = np.abs(np.diff(track.s)), np.abs(np.diff(track.d))
    moves = ds + dd > 0.05
    return track.length * float((dd[moves] / np.hypot(ds, dd)[moves]).max(initial=0.0))


def _common_instants(one: Track, other: Track) -> tuple[Track, Track]:
    """The two tracks at the instants at which both vehicles are present."""
    if np.array_equal(one.time, other.time):
        return one, other
    times = np.intersect1d(one.time, other.time)
    return one[np.isin(one.time, times)], other[np.isin(other.time, times)]


def comfort(tracks: Sequence[Track]) -> dict[str, float]:
    """Comfort of all these vehicles together.

    Keys: jerk_50, jerk_95, jerk_99 [m/s³] (quantiles of |jerk|), min_acceleration [m/s²], and the numbers of times that
    a vehicle begins to brake harder than 2, 3 and 4.5 m/s²: brakings_2, brakings_3, hard_brakings. Without any instant
    all are NaN.
    """
    tracks = [track for track in tracks if len(track.time)]
    if not tracks:
        names = [f"jerk_{100 * q:.0f}" for q in JERK_QUANTILES] + [f"brakings_{x:.0f}" for x in BRAKING]
        return dict.fromkeys([*names, "min_acceleration", "hard_brakings"], np.nan)
    size = np.abs(np.concatenate([jerk(track) for track in tracks]))
    quantiles = np.quantile(size, JERK_QUANTILES) if len(size) else np.zeros(len(JERK_QUANTILES))
    return {
        **{f"jerk_{100 * q:.0f}": float(value) for q, value in zip(JERK_QUANTILES, quantiles, strict=True)},
        "min_acceleration": min(float(track.a.min()) for track in tracks),
        **{f"brakings_{x:.0f}": float(sum(brakings(track, x) for track in tracks)) for x in BRAKING},
        "hard_brakings": float(sum(brakings(track) for track in tracks)),
    }
