"""The vehicles around the groups of a round, as a policy gets them that looks at more than its own group."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from cosim.loop.state_layouts import Pose
from cosim.world.snapshot import Snapshot
from gri.core.nearby import OWN_WIDTH, Nearby, NextAhead

REACH = 100.0  # [m] along the road, from any vehicle of a group
_OWN_WIDTH, _HALF, _NONE, _NOTHING = (np.float32(value) for value in (OWN_WIDTH, 0.5, np.inf, 0.0))


@dataclass(frozen=True)
class Around:
    """All vehicles near a round, and the ids of the members of each of its groups.

    In a merge the lane of vehicle 0 ends at s = `lane_end` [m], and `side` is −1 where the target lane is on the right.
    """

    now: Snapshot
    members: Sequence[Collection[str]]
    lane_end: float | None = None
    side: int = 1


def nearby_vehicles(around: Around, pose: Pose) -> Nearby:
    """Who is near each group, of all vehicles that are not its members.

    `pose` are the places of the group's vehicles. Vehicles of other groups are among those around a group.
    """
    now = around.now
    rows = [_rows(now, of, s) for of, s in zip(around.members, pose.s, strict=True)]
    most = max((len(of) for of in rows), default=0)
    padded = np.array([[*of, *[-1] * (most - len(of))] for of in rows], dtype=int).reshape(len(rows), most)
    present, at = padded >= 0, np.maximum(padded, 0)

    def of(feature: np.ndarray) -> np.ndarray:
        return feature[at] if most else np.zeros(at.shape)

    def tensor(values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(values.astype(np.float32))

    return Nearby(
        ahead=tensor(of(now.s)[:, None] - pose.s[..., None]),
        across=tensor(around.side * (of(now.d)[:, None] - pose.d[..., None])),
        v=tensor(of(now.v)),
        length=tensor(of(now.length)),
        width=tensor(of(now.width)),
        present=torch.from_numpy(present),
        lane_left=None if around.lane_end is None else tensor(around.lane_end - pose.s),
    )


def next_ahead(around: Around, pose: Pose) -> NextAhead:
    """What `nearby_vehicles` says of the next vehicle ahead in the path of each vehicle, in fewer calls."""
    now, (groups, size) = around.now, pose.s.shape
    if not now.ids:
        return NextAhead(np.full((groups, size), np.inf, np.float32), np.zeros((groups, size), np.float32))
    ahead = (now.s - pose.s[..., None]).astype(np.float32)
    across = (now.d - pose.d[..., None]).astype(np.float32)  # on which side does not matter
    length, width = now.length.astype(np.float32), now.width.astype(np.float32)
    in_path = np.abs(across) < _HALF * (width + _OWN_WIDTH)
    in_path &= ahead > 0
    for g, (members, s) in enumerate(zip(around.members, pose.s.tolist(), strict=True)):
        in_path[g] &= (now.s >= min(s) - REACH) & (now.s <= max(s) + REACH)
        in_path[g][:, [now.row_of[vehicle] for vehicle in members if vehicle in now.row_of]] = False
    ahead -= length
    gaps = np.where(in_path, ahead, _NONE).reshape(groups * size, -1)
    which = gaps.argmin(-1)
    gap = gaps[np.arange(len(gaps)), which].reshape(groups, size)
    v = np.where(gap < _NONE, now.v[which].astype(np.float32).reshape(groups, size), _NOTHING)
    return NextAhead(gap, v)


def _rows(now: Snapshot, members: Collection[str], s: np.ndarray) -> list[int]:
    near = np.flatnonzero((now.s >= s.min() - REACH) & (now.s <= s.max() + REACH))
    return [row for row in near.tolist() if now.ids[row] not in members]
