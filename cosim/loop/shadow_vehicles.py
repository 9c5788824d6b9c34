"""Shadow vehicles: a driven vehicle between two lanes is made visible in both.

SUMO's lane-change model LC2013 sees a vehicle on one lane only, the one it is assigned to. While a driven vehicle
merges, a shadow vehicle stands for it on the other lane. At first, the shadow is in the centre of the target lane and
announces the merge as an indicator would. While the vehicle is across the line, the shadow is at the vehicle's own
position, assigned to the other lane. It is removed when the vehicle has left its old lane. Without shadows, background
vehicles drive into merging ones (docs/coupling.md has the measurement).
"""

from dataclasses import dataclass

import numpy as np

from cosim.sumo import Sumo
from cosim.world.groups import MergeLanes
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Snapshot

CLEARANCE = 0.5  # [m] between an announcing shadow and others in the target lane, which it must not push


@dataclass(frozen=True)
class ShadowPlacement:
    """The lanes of a vehicle and its shadow.

    `own_lane` is the lane that SUMO assigns the vehicle to ("": the nearest one), `shadow_lane` that of its shadow
    (None: there is no shadow), `shadow_d` [m] is the shadow's lateral position.
    """

    own_lane: str = ""
    shadow_lane: str | None = None
    shadow_d: float = 0.0


def shadow_placement(s: float, d: float, width: float, lanes: MergeLanes) -> ShadowPlacement:
    """The lanes of a vehicle with its front at (s, d) [m], on its way to the target lane, and of its shadow."""
    if not max(lanes.source.begin, lanes.target.begin) <= s <= min(lanes.source.end, lanes.target.end):
        return ShadowPlacement()
    beyond, pair = lanes.beyond(d), lanes.at(s)
    if beyond >= 0.5 * width:
        return ShadowPlacement()
    if beyond >= 0:
        return ShadowPlacement(pair.target, pair.source, d)
    if beyond > -0.5 * width:
        return ShadowPlacement(pair.source, pair.target, d)
    return ShadowPlacement("", pair.target, lanes.target.centre)


def is_free(s: float, length: float, lanes: MergeLanes, now: Snapshot, own: int, dt: float) -> bool:
    """Whether a vehicle of that length fits into the target lane with its front at `s` [m], `dt` [s] after `now`.

    `own` is its row in the snapshot.
    """
    front = now.s + now.v * dt
    near = np.abs(now.d - lanes.target.centre) < 0.5 * lanes.target.width
    near &= front >= s - length - CLEARANCE
    near &= front - now.length <= s + CLEARANCE
    near[own] = False
    return not near.any()


def place(
    world: Sumo,
    road: RoadFrame,
    vehicle: str,
    pose: tuple[float, float, float, float],
    lanes: MergeLanes,
    now: Snapshot,
    dt: float,
    *,
    announcing: bool = True,
) -> str:
    """Add, move or remove the shadow of a vehicle whose next pose is (s, d, heading relative to the road, v).

    A vehicle that is on its own lane alone has a shadow only if it is `announcing` a merge. Returns the lane that SUMO
    is to assign the vehicle itself to.
    """
    s, d, heading, v = pose
    row = now.row_of.get(vehicle)
    if row is None:  # the vehicle is gone
        world.remove_shadow(vehicle)
        return ""
    wanted = shadow_placement(s, d, float(now.width[row]), lanes)
    announces = wanted.shadow_lane is not None and not wanted.own_lane
    if wanted.shadow_lane is None or (announces and not announcing):
        world.remove_shadow(vehicle)
        return wanted.own_lane
    if announces and not is_free(s, float(now.length[row]), lanes, now, row, dt):
        world.remove_shadow(vehicle)
        return wanted.own_lane
    xy, along = road.to_world(np.array([s]), np.array([wanted.shadow_d]))
    turned = float(along[0]) + road.side * (0.0 if announces else heading)
    world.place_shadow(vehicle, float(xy[0, 0]), float(xy[0, 1]), turned, v, wanted.shadow_lane)
    return wanted.own_lane
