"""When a group cannot, or need not, be driven any further; pure functions of two successive observations."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from cosim.loop.observation import GroupObservation
from cosim.world.episode import COLUMNS, Ending
from cosim.world.groups import SAME_LANE, MergeLanes
from cosim.world.snapshot import Snapshot

_S, _D, _V = (COLUMNS.index(name) for name in ("s", "d", "v"))

State = Float[np.ndarray, "3 C"]
Rows = Int[np.ndarray, " 3"]


def car_following(
    before: Float[np.ndarray, "G N C"],
    now: Float[np.ndarray, "G N C"],
    rows: Int[np.ndarray, "G N"],
    ahead: Int[np.ndarray, "G F"],
    has_third_vehicle: bool = True,
) -> list[Ending | None]:
    """LANE_LEFT where a vehicle left its lane, CUT_IN where another one came between, by group.

    `ahead` are the rows of the next vehicles ahead of all vehicles but the leader. Without a third vehicle only
    vehicles 0 and 1 count.
    """
    pairs = ahead.shape[1] if has_third_vehicle else 1
    moved = np.abs(now[..., _D] - before[..., _D]) > SAME_LANE
    broken = ahead[:, :pairs] != rows[:, 1 : pairs + 1]
    if not moved.any() and not broken.any():
        return [None] * len(now)
    return [
        Ending.LANE_LEFT if lane_left else Ending.CUT_IN if cut_in else None
        for lane_left, cut_in in zip(*(np.logical_or.reduce(of, axis=1) for of in (moved, broken)), strict=True)
    ]


def all_follow(
    before: GroupObservation, now: GroupObservation, snapshot: Snapshot, active: Sequence[int], has_third_vehicle: bool
) -> bool:
    """Whether every vehicle of the active groups, all present, kept its lane and is next behind its leader there.

    Then `car_following` ends no group, which takes longer to find out. False may also mean that this is not sure.
    """
    state, rows = now.state[active], now.rows[active]
    if not now.complete or (np.abs(state[..., _D] - before.state[active, :, _D]) > SAME_LANE).any():
        return False
    followers = state.shape[1] - 1 if has_third_vehicle else 1
    behind, ahead = rows[:, :followers].ravel(), rows[:, 1 : followers + 1].ravel()
    s, d = snapshot.s[behind], snapshot.d[behind]
    own = snapshot.s[ahead] - s
    distance = snapshot.s - s[:, None]  # Shape: (R, V)
    between = (distance > 0) & (distance <= own[:, None]) & (np.abs(snapshot.d - d[:, None]) < SAME_LANE)
    return bool(np.count_nonzero(between) == len(own) and between[np.arange(len(own)), ahead].all())


def merging(
    before: State, now: State, snapshot: Snapshot, rows: Rows, lanes: MergeLanes, width: float, dt: float
) -> Ending | None:
    """The ending of one group in which vehicle 0 merges; `width` [m] is that of vehicle 0.

    LANE_LEFT: the lag vehicle or the leader changed its lane, or the lag vehicle is outside it when vehicle 0 is inside
    (drifting alone ends no drive, so that what it leads to is seen). CUT_IN: another vehicle is between these two.
    LANE_END: the front of vehicle 0 would pass the end of its lane in the next step while its centre is still on it;
    there is no road beyond. MERGED: vehicle 0 is inside the target lane now; how long it must stay there is not decided
    here.
    """
    if (np.abs(now[1:, _D] - before[1:, _D]) > SAME_LANE).any():
        return Ending.LANE_LEFT
    if _between(snapshot, rows, lanes).any():
        return Ending.CUT_IN
    ending = merging_alone(now[0], lanes, width, dt)
    if ending is not Ending.MERGED:
        return ending
    lag_in_lane = abs(now[1, _D] - lanes.target.centre) <= 0.5 * lanes.target.width
    return Ending.MERGED if lag_in_lane else Ending.LANE_LEFT


def merging_alone(now: Float[np.ndarray, " C"], lanes: MergeLanes, width: float, dt: float) -> Ending | None:
    """LANE_END and MERGED as in `merging`, of a vehicle 0 whose group others may join."""
    if now[_S] + now[_V] * dt >= lanes.source.end and lanes.beyond(now[_D]) < 0:
        return Ending.LANE_END
    inside = abs(now[_D] - lanes.target.centre) + 0.5 * width <= 0.5 * lanes.target.width
    return Ending.MERGED if inside else None


def _between(snapshot: Snapshot, rows: Rows, lanes: MergeLanes) -> Bool[np.ndarray, " V"]:
    """The other vehicles in the target lane between the lag vehicle and the leader."""
    between = np.abs(snapshot.d - lanes.target.centre) < SAME_LANE
    between &= (snapshot.s > snapshot.s[rows[1]]) & (snapshot.s < snapshot.s[rows[2]])
    between[rows] = False
    return between
