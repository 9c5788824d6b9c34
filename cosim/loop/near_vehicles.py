"""Who is near the driven vehicles, in or out of their groups: what a safety filter and a reference driver look at."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from cosim.loop.state_layouts import Pose
from cosim.world.groups import Group
from cosim.world.snapshot import Snapshot

FASTEST_ACROSS = 2.5  # [m/s]; SUMO's instantaneous lane changes would look faster


@dataclass(frozen=True)
class NearVehicles:
    """The vehicles of G groups (by role) beside all V vehicles of a snapshot, in the road frame.

    `pose` and `across` (the lateral speed to the left) are those of the groups; the arrays of V are those of everybody.
    s [m] is the front bumper, d [m] the centre line, v and across are in m/s, sizes in m. Members of the groups are
    where the loop has put them. `other` says which of the V is another vehicle than the member, `row` which of the V
    the member is (0 where it is absent).
    """

    pose: Pose
    across: Float[np.ndarray, "G N"]
    length: Float[np.ndarray, "G N"]
    width: Float[np.ndarray, "G N"]
    s: Float[np.ndarray, " V"]
    d: Float[np.ndarray, " V"]
    v: Float[np.ndarray, " V"]
    across_of: Float[np.ndarray, " V"]
    length_of: Float[np.ndarray, " V"]
    width_of: Float[np.ndarray, " V"]
    other: Bool[np.ndarray, "G N V"]
    row: Int[np.ndarray, "G N"]

    @property
    def gap_ahead(self) -> Float[np.ndarray, "G N V"]:
        """Net distance [m] along the road to a vehicle ahead; below 0 where it is beside or behind."""
        return self.s - self.length_of - self.pose.s[..., None]

    @property
    def gap_behind(self) -> Float[np.ndarray, "G N V"]:
        """Net distance [m] along the road to a vehicle behind; below 0 where it is beside or ahead."""
        return (self.pose.s - self.length)[..., None] - self.s

    @property
    def ahead(self) -> Bool[np.ndarray, "G N V"]:
        """Whether another vehicle's front is farther along the road."""
        return self.other & (self.s >= self.pose.s[..., None])

    @property
    def side_gap(self) -> Float[np.ndarray, "G N V"]:
        """Net distance [m] across the road; below 0 where the vehicles overlap sideways."""
        return np.abs(self.d - self.pose.d[..., None]) - (self.width[..., None] + self.width_of) / 2

    @property
    def direction(self) -> Float[np.ndarray, "G N V"]:
        """+1 where the other vehicle is on the left, −1 where it is on the right."""
        return np.where(self.d >= self.pose.d[..., None], 1.0, -1.0)


class Lookout:
    """Looks at the vehicles near the groups in every step; lateral speeds are differences between two looks."""

    def __init__(self, groups: Sequence[Group]) -> None:
        self._ids: Sequence[Sequence[str]] = [group.ids for group in groups]
        self._last: tuple[float, dict[str, float]] | None = None

    def change_members(self, ids: Sequence[Sequence[str]]) -> None:
        """Go on with these members of the groups; "" where nobody has a role."""
        self._ids = [[*of] for of in ids]

    def look(self, now: Snapshot, pose: Pose) -> NearVehicles:
        """The vehicles of a snapshot, with the members of the groups where `pose` says."""
        s, d, v, across = now.s.copy(), now.d.copy(), now.v.copy(), self._across(now)
        own_across = pose.v * np.sin(pose.heading)
        other = np.ones((*pose.s.shape, len(s)), dtype=bool)
        length, width = np.full(pose.s.shape, 5.0), np.full(pose.s.shape, 1.8)
        rows = np.zeros(pose.s.shape, dtype=int)
        for g, ids in enumerate(self._ids):
            for role, vehicle in enumerate(ids):
                row = now.row_of.get(vehicle)
                if row is None:
                    continue
                s[row], d[row], v[row] = pose.s[g, role], pose.d[g, role], pose.v[g, role]
                across[row] = own_across[g, role]
                length[g, role], width[g, role] = now.length[row], now.width[row]
                other[g, role, row], rows[g, role] = False, row
        return NearVehicles(pose, own_across, length, width, s, d, v, across, now.length, now.width, other, rows)

    def _across(self, now: Snapshot) -> Float[np.ndarray, " V"]:
        """Lateral speeds [m/s] from the last look; 0 for vehicles that have just come or jumped to another lane."""
        d = dict(zip(now.ids, now.d.tolist(), strict=True))
        last, self._last = self._last, (now.time, d)
        if last is None or now.time <= last[0]:
            return np.zeros(len(now.ids))
        moved = np.array([d[vehicle] - last[1].get(vehicle, d[vehicle]) for vehicle in now.ids])
        speed = moved.reshape(-1) / (now.time - last[0])
        return np.where(np.abs(speed) <= FASTEST_ACROSS, speed, 0.0)
