"""Vehicles that are between two lanes, made visible in both.

LC2013 knows a vehicle on one lane only, the one it is booked on. While an owned vehicle merges, a twin stands for it on
the other lane: on the target lane from the moment the merge is decided (that is what an indicator says), on the
vehicle's own body while it is across the line, then on the lane it leaves, until it is clear of it. Measured: no
background vehicle drives into a merging one, where without a twin every third does (docs/coupling.md).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from cosim.sumo import Sumo
from cosim.world.groups import MergeLanes
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Snapshot

CLEARANCE = 0.5  # [m] a twin in the target lane keeps from those who are there; it must not push anybody


@dataclass(frozen=True)
class ShadowPlacement:
    """On which lane SUMO shall book a vehicle ("": the nearest one), and where its twin shall be (None: none)."""

    own: str = ""
    twin: str | None = None
    shadow_d: float = 0.0


def booking(s: float, d: float, width: float, lanes: MergeLanes) -> ShadowPlacement:
    """What is to be booked where, for a vehicle with its front at (s, d) that is on its way to the target lane."""
    if not max(lanes.source.begin, lanes.target.begin) <= s <= min(lanes.source.end, lanes.target.end):
        return ShadowPlacement()
    beyond = d - lanes.boundary
    if beyond >= 0.5 * width:
        return ShadowPlacement()
    if beyond >= 0:
        return ShadowPlacement(lanes.target.lane, lanes.source.lane, d)
    if beyond > -0.5 * width:
        return ShadowPlacement(lanes.source.lane, lanes.target.lane, d)
    return ShadowPlacement("", lanes.target.lane, lanes.target.centre)


def is_free(
    s: float, length: float, lanes: MergeLanes, now: Snapshot, others: Bool[np.ndarray, " V"], dt: float
) -> bool:
    """Whether a vehicle of that length fits into the target lane with its front at s, one step after the snapshot."""
    there = others & (np.abs(now.d - lanes.target.centre) < 0.5 * lanes.target.width)
    front = now.s[there] + now.v[there] * dt
    apart = (front < s - length - CLEARANCE) | (front - now.length[there] > s + CLEARANCE)
    return bool(apart.all())


def place(
    world: Sumo,
    road: RoadFrame,
    vehicle: str,
    pose: tuple[float, float, float, float],
    lanes: MergeLanes,
    now: Snapshot,
    dt: float,
) -> str:
    """Move, make or remove the twin of a vehicle whose next pose is (s, d, heading from the road, v).

    Returns the lane on which the vehicle itself is to be booked.
    """
    s, d, heading, v = pose
    row = now.where.get(vehicle)
    if row is None:  # it is gone; there is nothing to stand for
        world.remove_shadow(vehicle)
        return ""
    others = np.ones(len(now.ids), dtype=bool)
    others[row] = False
    wanted = booking(s, d, float(now.width[row]), lanes)
    announced = wanted.twin is not None and not wanted.own
    if wanted.twin is None or (announced and not is_free(s, float(now.length[row]), lanes, now, others, dt)):
        world.remove_shadow(vehicle)
        return wanted.own
    xy, along = road.to_world(np.array([s]), np.array([wanted.shadow_d]))
    turned = float(along[0]) + (0.0 if announced else heading)
    world.place_shadow(vehicle, float(xy[0, 0]), float(xy[0, 1]), turned, v, wanted.twin)
    return wanted.own
