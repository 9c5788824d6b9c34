"""Who has which role of a group, where vehicles that come between its members join it (`newcomers: join`).

A merge is what is next to the merging vehicle in the target lane: whoever is next ahead of it has the role of the
leader, whoever is next behind it that of the lag vehicle. In car following the roles are the vehicles ahead of vehicle
0, one after the other. Members are replaced only where they have to be: by a vehicle that is between, or where a member
left the lane, the simulation, or its place in the order.

A vehicle that the policy drives and that loses its role is handed back; a newcomer is left to whoever drives it. Where
nobody has a role, the policy sees a vehicle far away, as fast as vehicle 0.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from cosim.loop.observation import GroupObservation
from cosim.loop.round_recorder import Round
from cosim.spec.scenario import Merge
from cosim.world.episode import COLUMNS, RoleChange
from cosim.world.groups import SAME_LANE, MergeLanes, next_ahead
from cosim.world.road_frame import NOMINAL_LENGTH, RoadFrame
from cosim.world.snapshot import Snapshot

NOBODY = ""
FAR = 500.0
"""[m] along the road from vehicle 0, where the policy sees a vehicle in a role that nobody has."""
_S, _D, _X, _Y, _HEADING, _V = (COLUMNS.index(name) for name in ("s", "d", "x", "y", "heading", "v"))


class Membership:
    """The vehicles of the groups of a round by role, as they change; only vehicle 0 stays for the whole drive.

    `ids` are the present ones (NOBODY where a role is empty), `driven` says which of them the policy still drives,
    `changes` are the changes of each group so far, `left` the driven vehicles of each group that lost their role, with
    the time [s].
    """

    def __init__(self, this_round: Round) -> None:
        self._round = this_round
        self.ids = [[*group.ids] for group in this_round.groups]
        self.driven = np.zeros((len(self.ids), this_round.size), dtype=bool)
        self.driven[:, list(this_round.driven_roles)] = True
        self.changes: list[list[RoleChange]] = [[] for _ in self.ids]
        self.left: list[dict[str, float]] = [{} for _ in self.ids]

    def update(self, now: Snapshot, active: Iterable[int]) -> dict[int, list[int]]:
        """Give the roles of the active groups to those who have them now; the roles that changed, by group."""
        changed: dict[int, list[int]] = {}
        for g in active:
            old, new = self.ids[g], self._found(now, self.ids[g])
            roles = [role for role, (before, after) in enumerate(zip(old, new, strict=True)) if before != after]
            if not roles:
                continue
            changed[g], self.ids[g] = roles, new
            for role in roles:
                self.changes[g].append(RoleChange(now.time, role, new[role]))
                if self.driven[g, role]:
                    self.left[g][old[role]] = now.time
                    self.driven[g, role] = False
        return changed

    def _found(self, now: Snapshot, ids: Sequence[str]) -> list[str]:
        if ids[0] not in now.row_of:
            return [*ids]
        if isinstance(self._round.rule, Merge):
            assert self._round.lanes is not None, "a merge takes place between two lanes"
            return [ids[0], *_beside(now, self._round.lanes, *ids)]
        chain = [now.row_of[ids[0]]]
        while len(chain) < len(ids) and (ahead := int(next_ahead(now, np.array(chain[-1:]))[0])) >= 0:
            chain.append(ahead)
        return [*(now.ids[row] for row in chain), *[NOBODY] * (len(ids) - len(chain))]

    def driven_until(self, g: int, role: int) -> float:
        """When [s] the vehicle that had a role at the take-over lost it, if it was driven; +inf while it has it."""
        return self.left[g].get(self._round.groups[g].ids[role], np.inf)

    @property
    def vehicles(self) -> list[str]:
        """The present members, group by group."""
        return [vehicle for of in self.ids for vehicle in of]

    def observe(self, now: Snapshot) -> GroupObservation:
        """The groups at this instant, with the present members."""
        return GroupObservation.of_vehicles(now, self.vehicles, len(self.ids))

    def lengths(self, now: Snapshot, g: int) -> Float[np.ndarray, " N"]:
        """The lengths [m] of the members of a group; where nobody has a role, that of any vehicle in model states."""
        rows = [now.row_of.get(vehicle) for vehicle in self.ids[g]]
        return np.array([NOMINAL_LENGTH if row is None else now.length[row] for row in rows])

    def shown(self, observation: GroupObservation, road: RoadFrame) -> GroupObservation:
        """The observation as the policy gets it: with a vehicle far away in each role that nobody has."""
        empty = [(g, r) for g, of in enumerate(self.ids) for r, vehicle in enumerate(of) if vehicle == NOBODY]
        if not empty:
            return observation
        state, is_merge = observation.state.copy(), isinstance(self._round.rule, Merge)
        for g, role in empty:
            own, behind = state[g, 0], is_merge and role == 1
            lanes = self._round.lanes
            s = own[_S] + (-FAR if behind else FAR)
            d = lanes.target.centre if lanes is not None else own[_D]
            xy, heading = road.to_world(np.array([s]), np.array([d]))
            state[g, role] = 0.0
            state[g, role, [_S, _D, _X, _Y, _HEADING, _V]] = s, d, *xy[0], heading[0], own[_V]
        return replace(observation, state=state)


def _beside(now: Snapshot, lanes: MergeLanes, merging: str, lag: str, leader: str) -> tuple[str, str]:
    """The lag vehicle and the leader of a merge: the present ones, unless others have taken their places."""
    row = now.row_of[merging]
    s, front, rear = now.s, float(now.s[row]), float(now.s[row] - now.length[row])
    in_lane = np.abs(now.d - lanes.target.centre) < SAME_LANE
    lag_row, leader_row = now.row_of.get(lag), now.row_of.get(leader)
    if lag_row is not None and leader_row is not None and in_lane[lag_row] and in_lane[leader_row]:
        lag_s, leader_s = float(s[lag_row]), float(s[leader_row])
        between = in_lane & (s > min(lag_s, front)) & (s < leader_s)
        between[[row, lag_row]] = False
        if leader_s >= rear and lag_s - now.length[lag_row] <= front and not between.any():
            return lag, leader  # as almost always: nobody else is between them
    in_lane[row] = False
    if leader_row is not None and (not in_lane[leader_row] or s[leader_row] < rear):
        leader_row = None  # it left the lane, or vehicle 0 has passed it
    if lag_row is not None and (not in_lane[lag_row] or s[lag_row] - now.length[lag_row] > front):
        lag_row = None
    ahead, behind = in_lane & (s > front), in_lane & (s <= front)
    ahead[_some(lag_row)] = behind[_some(leader_row)] = False
    if leader_row is not None:
        ahead &= s < s[leader_row]
        behind &= s < s[leader_row]
    if lag_row is not None:
        behind &= s > s[lag_row]
    new_leader = _nearest(ahead, s - front, leader_row)
    new_lag = _nearest(behind, front - s, lag_row)
    return _id(now, new_lag), _id(now, new_leader)


def _id(now: Snapshot, row: int | None) -> str:
    return NOBODY if row is None else now.ids[row]


def _some(row: int | None) -> list[int]:
    return [] if row is None else [row]


def _nearest(which: Bool[np.ndarray, " V"], distance: Float[np.ndarray, " V"], otherwise: int | None) -> int | None:
    """The row of the nearest vehicle of these, or the other one where there is none."""
    return int(np.where(which, distance, np.inf).argmin()) if which.any() else otherwise
