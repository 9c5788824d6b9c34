"""One round in the compiled core: what it is told, and the steps that it makes and records."""

import ctypes
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from cosim.core import library as c
from cosim.core.numpy_loops import loops
from cosim.sumo import SumoError
from cosim.world.groups import LanePair, MergeLanes
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import COLUMNS, Snapshot
from cosim.world.surroundings import Instant
from gri.networks.fast_decoder import FewVehicles

_C = len(COLUMNS)


@dataclass(frozen=True)
class RoundFacts:
    """What does not change in a round of G groups of N vehicles, whose road is straight.

    `members` are the ids of all vehicles, group by group, and `width` [m] are theirs. Model states have D features: x
    is s + `offset` [m]; with D = 3 `across` are the places d [m] of all vehicles, with D = 6 those of the target lane
    of each group, and y counts to its `side`. `matrix` [I, D] is that of the dynamics, `every` the number of steps
    between two actions. `is_euler` is off with SUMO's ballistic update. `before` is the state at the take-over.
    A vehicle has merged after `settle` [s] in the target lane; `steps_inside` counts its steps there so
    far, and is shared with the caller. With `others_join` the members of groups change.
    """

    dt: float
    road: RoadFrame
    is_euler: bool
    members: tuple[str, ...]
    driven_roles: tuple[int, ...]
    lanes: MergeLanes | None
    has_third: bool
    records_surroundings: bool
    width: Float[np.ndarray, "G N"]
    offset: Float[np.ndarray, "G N"]
    across: Float[np.ndarray, "*n"]
    side: int
    matrix: Float[np.ndarray, "I D"]
    every: int
    before: Float[np.ndarray, "G N C"]
    settle: float
    steps_inside: Int[np.ndarray, " G"]
    others_join: bool = False


@dataclass(frozen=True)
class Steps:
    """K steps that were made: what was observed after each of them, and what had been commanded.

    `pose` are s, d, relative heading, v and a. `state` are the model states of each decision of the policy.
    """

    time: Float[np.ndarray, " K"]
    observed: Float[np.ndarray, "K G N C"]
    valid: Bool[np.ndarray, "K G N"]
    rows: Int[np.ndarray, "K G N"]
    pose: Float[np.ndarray, "P 5 G N"]
    state: Float[np.ndarray, "M G N D"]
    found: Sequence[tuple[Snapshot, Instant]]
    speeds: Float[np.ndarray, "K L"]
    """Those [m/s] of the vehicles of `RoundCore.record_speeds`, nan for one that is gone."""

    def __len__(self) -> int:
        return len(self.time)


class RoundCore:
    """Steps one round in compiled code.

    `state`, `commanded` (model states [G, N, D]), `action` [G, N, A], `pose` [5, G, N], `active` [G], `shadowed` [G]
    and `driven` [G, N] are shared with that code: what is written into them before a call counts. `change_shadow`
    (group, wanted) adds or removes the shadow of a merging vehicle, `before_step` is called before every step.
    """

    def __init__(
        self,
        facts: RoundFacts,
        change_shadow: Callable[[int, int], object],
        before_step: Callable[[], object] | None = None,
    ) -> None:
        groups, size, features = len(facts.before), facts.before.shape[1], facts.matrix.shape[1]
        self.state, self.commanded = np.zeros((groups, size, features)), np.zeros((groups, size, features))
        self.action = np.zeros((groups, size, features // 3), np.float32)
        self.pose = np.zeros((5, groups, size))
        self.active, self.shadowed = np.ones(groups, bool), np.zeros(groups, bool)
        self.driven = np.tile([role in facts.driven_roles for role in range(size)], (groups, 1))
        self._offset, self._across = facts.offset.copy(), facts.across.copy()
        self._features = groups, size, features
        self._library: Any = c.library()
        self._lists: list[tuple[str, ...]] = []
        self._records = c.Records()
        self._errors: list[BaseException] = []  # of the functions that the core calls
        self._shadow_call = c.ShadowCall(_guarded(change_shadow, self._errors))
        self._step_call = c.StepCall(_guarded(before_step, self._errors)) if before_step else c.StepCall()
        self._kept: dict[str, Any] = {}  # what the core has addresses of
        fields, names = self._fields(facts), ("\n".join(of).encode() for of in self._names(facts))
        self._handle = self._library.core_new(ctypes.byref(fields), *names)
        self._taken: tuple[str, ...] = ()

    def __del__(self) -> None:
        self._library.core_delete(self._handle)

    @staticmethod
    def _pairs(lanes: MergeLanes | None) -> Sequence[LanePair]:
        if lanes is None:
            return ()
        return lanes.pairs or (LanePair(lanes.source.lane, lanes.target.lane, lanes.source.end),)

    def _names(self, facts: RoundFacts) -> tuple[Sequence[str], Sequence[str], Sequence[str]]:
        pairs = self._pairs(facts.lanes)
        return facts.members, [pair.source for pair in pairs], [pair.target for pair in pairs]

    def _address(self, name: str, value: np.ndarray, dtype: Any = float) -> int:
        self._kept[name] = kept = np.ascontiguousarray(value, dtype)
        return kept.ctypes.data

    def _fields(self, facts: RoundFacts) -> c.RoundFields:
        groups, size, features = self._features
        line = facts.road.straight_line
        assert line is not None, "the core drives on straight roads"
        strips = () if facts.lanes is None else (facts.lanes.source, facts.lanes.target)
        pairs = self._pairs(facts.lanes)
        self._kept["matrix"], found = facts.matrix, loops()
        assert found is not None, "the caller asks for numpy's loops first"
        fields = c.RoundFields(
            dt=facts.dt,
            settle=facts.settle,
            road=(*line, float(facts.is_euler)),
            groups=groups,
            size=size,
            features=features,
            every=facts.every,
            side=facts.side,
            records=facts.records_surroundings,
            merge=facts.lanes is not None,
            has_third=facts.has_third,
            join=facts.others_join,
            offset=self._offset.ctypes.data,
            across=self._across.ctypes.data,
            width=self._address("width", facts.width),
            strips=self._address("strips", np.array([(of.begin, of.end, of.centre, of.width) for of in strips])),
            pairs=len(pairs),
            pair_ends=self._address("pair_ends", np.array([pair.end for pair in pairs])),
            loops=found,
            matrix=c.Array.of(facts.matrix),
            before=self._address("before", facts.before),
            shadow_call=self._shadow_call,
            step_call=self._step_call,
        )
        self._kept["inside"] = facts.steps_inside
        fields.inside = facts.steps_inside.ctypes.data
        for name in ("state", "commanded", "pose", "action", "active", "shadowed", "driven"):
            setattr(fields, name, getattr(self, name).ctypes.data)
        return fields

    def _checked(self, status: int) -> int:
        if status != c.FAILED:
            return status
        message = self._library.core_message(self._handle).decode(errors="replace")
        raise SumoError(message) from (self._errors.pop() if self._errors else None)

    def start(self, now: Snapshot, known: Sequence[str]) -> None:
        """Tell the vehicles at the take-over, and the ids of all that are `known` to be on the net, in order."""
        values = np.stack([now.s, now.d, now.v, now.length, now.width])
        ids, known_ids = "\n".join(now.ids).encode(), "\n".join(known).encode()
        self._checked(self._library.core_start(self._handle, now.time, ids, values.ctypes.data, known_ids))

    def change_members(
        self,
        ids: Sequence[Sequence[str]],
        driven: Bool[np.ndarray, "G N"],
        offset: Float[np.ndarray, "G N"],
        across: Float[np.ndarray, "*n"],
        observed: Float[np.ndarray, "G N C"],
    ) -> None:
        """Go on with these members of the groups, "" where nobody has a role; `observed` are the last known states."""
        self.driven[:], self._offset[:], self._across[:] = driven, offset, across
        names, states = "\n".join(vehicle for of in ids for vehicle in of).encode(), np.ascontiguousarray(observed)
        self._checked(self._library.core_members(self._handle, names, states.ctypes.data))

    def use(self, policy: FewVehicles, in_pairs: FewVehicles | None = None) -> None:
        """Let this policy decide from now on.

        Where it follows the next vehicle ahead, too, `in_pairs` is the one for as many scenes of two as there are
        members.
        """
        for which, one in enumerate((policy, in_pairs)):
            if one is not None and one is not self._kept.get(f"policy {which}"):
                self._use(one, which)

    def _use(self, policy: FewVehicles, which: int) -> None:
        inner = policy.inner
        weights, biases = (c.Array * len(inner))(), (ctypes.c_void_p * len(inner))()
        for k, (weight, bias) in enumerate(inner):
            weights[k], biases[k] = c.Array.of(weight), bias.ctypes.data
        rows = [receivers for _, receivers in policy.turns]

        def address(name: str, value: np.ndarray, dtype: Any = np.int64) -> int:
            return self._address(f"{name} {which}", value, dtype)

        mask = None if policy.mask is None else address("mask", policy.mask, np.float32)
        fields = c.PolicyFields(
            driven=len(policy.driven),
            pairs=len(policy.senders),
            end_sender=policy.ends[0],
            end_receiver=policy.ends[1],
            actions=policy.shape[2],
            turns=len(rows),
            inner=len(inner),
            read=c.Array.of(policy.read[0]),
            edge=c.Array.of(policy.edge[0]),
            node=c.Array.of(policy.node),
            last=c.Array.of(policy.last[0]),
            inner_weights=weights,
            inner_biases=biases,
            mask=mask,
            driven_rows=address("driven_rows", policy.driven),
            senders=address("senders", policy.senders),
            receivers=address("receivers", policy.receivers),
            turn_ends=address("turn_ends", np.array([pairs.stop for pairs, _ in policy.turns])),
            turn_receivers=address("turn_receivers", np.concatenate([*rows, np.empty(0)])),
        )
        for name, value in (
            ("read_bias", policy.read[1]),
            ("edge_bias", policy.edge[1]),
            ("last_bias", policy.last[1]),
            ("unit", policy.unit),
        ):
            setattr(fields, name, address(name, value, np.float32))
        self._kept[f"policy {which}"] = policy
        self._checked(self._library.core_policy(self._handle, ctypes.byref(fields), which))

    def repeat(self, vehicles: Sequence[str], steps: Sequence[Mapping[str, float]]) -> None:
        """Ask the drivers of these vehicles for the given speeds [m/s] in each step, counted from the take-over."""
        speeds = np.array([[of.get(vehicle, -1.0) for vehicle in vehicles] for of in steps])
        address, ids = self._address("ahead", speeds), "\n".join(vehicles).encode()
        self._checked(self._library.core_ahead(self._handle, ids, len(steps), address))

    def record_speeds(self, vehicles: Sequence[str]) -> None:
        """Record the speeds of these vehicles from now on."""
        self._checked(self._library.core_watch(self._handle, "\n".join(vehicles).encode()))

    def take(self, vehicles: tuple[str, ...]) -> None:
        """Tell which vehicles SUMO's drivers do not drive alone."""
        if vehicles != self._taken:
            self._taken = vehicles
            self._checked(self._library.core_taken(self._handle, "\n".join(vehicles).encode()))

    def advance(
        self, step: int, decisions: int, most: int, *, decided: bool, driving: bool, judging: bool
    ) -> tuple[int, int, Steps]:
        """Make steps until something happens, `most` steps at most.

        `step` is the number of the first one, `decisions` how many decisions the policy has made. Returns how it ended
        (QUIET; JUDGE: something may have happened in the last step; DECIDE: Python is to decide on the next one;
        REFUSED: a command that is not finite), the new number of decisions, and the steps.
        """
        call, options = self._library.core_advance, (decided, driving, judging)
        status = self._checked(call(self._handle, step, decisions, most, *options))
        self._library.core_records(self._handle, ctypes.byref(self._records))
        return status, self._records.decisions, self._steps()

    def _steps(self) -> Steps:
        of, (groups, size, features) = self._records, self._features
        for which in range(len(self._lists), of.lists):
            self._lists.append(tuple(self._library.core_list(self._handle, which).decode().split("\n")))
        k, shape = of.steps, (groups, size)
        return Steps(
            time=_copied(of.times, k),
            observed=_copied(of.observations, of.observation_length).reshape(k, *shape, _C),
            valid=_copied(of.valid, k * groups * size, np.bool_).reshape(k, *shape),
            rows=_copied(of.rows, k * groups * size, np.int32).astype(np.int64).reshape(k, *shape),
            pose=_copied(of.poses, of.pose_length).reshape(-1, 5, *shape),
            state=_copied(of.states, of.state_length).reshape(-1, *shape, features),
            found=self._found(k),
            speeds=_copied(of.speeds, of.speed_length).reshape(k, -1) if of.speed_length else np.empty((k, 0)),
        )

    def _found(self, steps: int) -> list[tuple[Snapshot, Instant]]:
        """The vehicles near the round and those to record, after each step."""
        of, found = self._records, []
        times, blocks, sizes = (
            _copied(of.times, steps),
            _copied(of.blocks, of.block_length),
            _copied(of.sizes, of.size_length),
        )
        rows = _copied(of.near_rows, of.near_length, np.int32)
        last_lanes = tuple(self._library.core_lanes(self._handle).decode().split("\n")[:-1])
        addresses = of.counts, of.near_counts, of.versions, of.near_versions
        each = [_copied(address, steps, np.int32).tolist() for address in addresses]
        begin = near_begin = 0
        for time, n, n_near, version, near_version in zip(times.tolist(), *each, strict=True):
            block = blocks[_C * begin : _C * (begin + n)].reshape(_C, n)
            size = sizes[2 * begin : 2 * (begin + n)].reshape(2, n)
            at, lane = rows[near_begin : near_begin + n_near], last_lanes if len(found) == steps - 1 else ()
            snapshot = Snapshot.of_block(time, self._lists[near_version], block[:, at], size[:, at], lane)
            found.append((snapshot, Instant(time, self._lists[version], block.T, *size)))
            begin, near_begin = begin + n, near_begin + n_near
        return found


def _guarded(function: Callable[..., object], errors: list[BaseException]) -> Callable[..., int]:
    """The function as compiled code can call it: no exception can pass through that."""

    def call(*arguments: int) -> int:
        try:
            function(*arguments)
        except BaseException as error:
            errors.append(error)
            return 1
        return 0

    return call


def _copied(address: int | None, length: int, dtype: Any = float) -> np.ndarray:
    values = np.empty(length, dtype)
    if address and length:
        ctypes.memmove(values.ctypes.data, address, values.nbytes)
    return values
