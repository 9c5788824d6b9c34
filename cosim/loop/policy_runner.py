"""Runs a policy for all groups of a round: observed states in, one model call, commanded poses out."""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from cosim.core import RoundCore
from cosim.loop.graph_source import on_same_pairs
from cosim.loop.guard import Guard
from cosim.loop.nearby_vehicles import Around, nearby_vehicles, next_ahead
from cosim.loop.observation import GroupObservation
from cosim.loop.own_policy import PolicyFailure
from cosim.loop.state_layouts import Layout, Pose
from cosim.perturb.effects import Effect
from cosim.perturb.sensing_and_control import SensingAndControl
from cosim.world.episode import COLUMNS, FilterUse
from cosim.world.road_frame import model_offsets
from cosim.world.snapshot import Snapshot
from gri.core.graph import InteractionGraph
from gri.core.nearby import Nearby, NextAhead
from gri.core.policy import Policy, PolicyState
from gri.core.trajectory import Trajectory
from gri.networks.fast_decoder import FewVehicles
from gri.networks.model import RelationalModel
from gri.networks.next_ahead import FollowsNextAhead

_D, _A = COLUMNS.index("d"), COLUMNS.index("a")
LARGEST = 1e6  # of any action in SI units, far beyond what a vehicle can do
GraphOverride = Callable[[InteractionGraph, InteractionGraph | None], InteractionGraph]
Newcomers = Callable[[InteractionGraph, Collection[int]], InteractionGraph]


class PolicyRunner:
    """The model states of all groups of a round and the policy's memory of them; to be used in inference mode.

    The graph is inferred from `history` as the channels show it; the vehicles are driven from `start` on, which may
    differ from the end of the history. `driven_roles` are the roles that the policy drives. `override_graph` turns the
    inferred graph and the last one (None at first) into the one that the policy uses. `reinfer_steps` says how often
    the graph is inferred again (0: never). `channels` are the perturbed sensors and actuators. Where the driven
    vehicles have a view each, the policy gets the groups once per view, and each role is driven by its own view.
    `around` are the vehicles near the round at its start, for policies that look at them (`sees_nearby`).
    `graphs` are the graphs used so far, each with its time [s]; an effect on a vehicle is the one in the view that
    drives it. `guard` changes actions before the vehicles carry them out. `with_newcomers` gives the graph of groups
    in which others have some roles now.
    """

    def __init__(
        self,
        policy: Policy,
        layout: Layout,
        history: Sequence[GroupObservation],
        start: GroupObservation,
        *,
        driven_roles: Sequence[int],
        dt: float,
        override_graph: GraphOverride,
        reinfer_steps: int,
        channels: SensingAndControl,
        around: Around | None = None,
        guard: Guard | None = None,
        with_newcomers: Newcomers | None = None,
    ) -> None:
        assert policy.dynamics.name is layout.dynamics.name, f"cannot drive {policy.dynamics.name} states here"
        self._policy, self.layout, self._dt = policy, layout, dt
        self._every = max(round(policy.dt / dt), 1)  # steps between two actions of the policy
        self._dynamics, self._speed = policy.dynamics, policy.dynamics.speed
        self._driven_roles, self._override_graph = list(driven_roles), override_graph
        self._reinfer_steps, self._channels, self._perfect = reinfer_steps, channels, channels.changes_nothing
        self._mask: tuple[list[int], np.ndarray] | None = None  # active groups, and the vehicles driven in them
        if self._perfect and layout.is_pointwise:  # all of it at once
            sampled = layout.states(np.stack([observation.state for observation in history[:: -self._every][::-1]]))
            self._window = deque(sampled, policy.history_steps)
        else:
            *past, latest = (torch.from_numpy(layout.states(observation.state)) for observation in history)
            observed = [channels.observed(state) for state in past] + [channels.observed(latest, final=False)]
            views = (of.flatten(0, 1).numpy() for of in observed[:: -self._every][::-1])
            self._window = deque(views, policy.history_steps)
        self._state = self._commanded = layout.states(start.state)
        self.pose = layout.pose(self._commanded)
        self._decided_at: float | None = None
        self._guard = guard
        self._with_newcomers = with_newcomers
        self._together_since = np.full(len(self._state), -np.inf)  # of each group, the last change of its members [s]
        self._may_drive: Bool[np.ndarray, "G N"] | None = None  # None: all driven roles
        self._steps, self._took_over = 0, history[-1].time
        self.graphs: list[tuple[float, InteractionGraph]] = []
        self.failures: dict[int, str] = {}  # groups for which the policy has given no usable answer, and why
        self._around = around
        self._action_now = torch.zeros(*self._state.shape[:2], len(policy.dynamics.action))
        self._memory = PolicyState.empty(Trajectory.complete(_relative(np.stack(self._window, axis=2)), self._period))
        try:
            self._memory = self._infer_graph(None)
            self._record_graph(history[-1].time)
        except PolicyFailure as failure:
            self._fail(range(len(self._state)), str(failure))

    @property
    def _period(self) -> float:
        """Time [s] between two actions of the policy."""
        return self._every * self._dt

    def _infer_graph(self, last: InteractionGraph | None) -> PolicyState:
        """The policy's memory of the window, with the graph that it is to use."""
        states = _relative(np.stack(self._window, axis=2))
        memory = self._policy.begin(Trajectory.complete(states, self._period))
        return memory if memory.graph is None else replace(memory, graph=self._override_graph(memory.graph, last))

    def _record_graph(self, time: float) -> None:
        if self._memory.graph is not None:
            self.graphs.append((time, _graph_of_views(self._memory.graph, self._channels.view_of)))

    def decide(self, now: Snapshot) -> None:
        """Call the policy and the dynamics: `pose` becomes where the vehicles are to be after the next step.

        A policy with a longer period than the step keeps its action until the period is over.
        A second call at the same instant changes nothing, so that the first decision can be made before a branch.
        """
        time = now.time
        if time == self._decided_at:
            return
        self._decided_at = time
        observed = self._observed()
        if self._steps % self._every == 0:
            self._action_now = self._usable(self._of_own_view(self._action(observed, time)))
        allowed = self._action_now
        if self._guard is not None:
            changed = self._guard.change(self._state, allowed.numpy().astype(float), now, self.layout)
            allowed = torch.from_numpy(changed.astype(np.float32))
        action = self._channels.executed_action(allowed)
        self._commanded = self._next_state(action.numpy().astype(float))
        self._steps += 1
        self.pose = self.layout.pose(self._commanded)

    def _observed(self) -> Float[np.ndarray, "V N D"]:
        """The present states as the channels show them, in each view."""
        if self._perfect:
            return self._state
        return self._channels.observed(torch.from_numpy(self._state)).flatten(0, 1).numpy()

    def states_for_policy(self) -> Float[Tensor, "V N D"]:
        """What the policy would get now; after the end of a drive, the states in which it ended."""
        return _relative(self._observed())

    def _action(self, observed: Float[np.ndarray, "V N D"], time: float) -> Float[Tensor, "V N A"]:
        """The policy's action in each view, from a new graph where it is time for one; 0 where the policy fails."""
        if len(self.failures) == len(self._state):
            return self._no_action(observed)
        try:
            if self._reinfer_steps and self._steps:
                self._window.append(observed)
                if self._steps % self._reinfer_steps == 0:
                    self._memory = replace(self._memory, graph=self._inferred_again(time))
                    self._record_graph(time)
            action, self._memory = self._act(_relative(observed))
        except PolicyFailure as failure:
            self._fail(range(len(self._state)), str(failure))
            return self._no_action(observed)
        return action

    def _inferred_again(self, time: float) -> InteractionGraph | None:
        """The new graph; the last one for groups that have not been together for a whole history."""
        last = self._memory.graph
        graph = self._infer_graph(last).graph
        known = time - self._together_since >= self._policy.history_steps * self._period - 1e-6
        if graph is None or last is None or known.all():
            return graph
        graph, last = on_same_pairs([graph, last])
        return graph.where(torch.from_numpy(np.tile(known, self._channels.views)), last)

    def change_roles(
        self,
        changed: Mapping[int, Collection[int]],
        ids: Sequence[Sequence[str]],
        lengths: Mapping[int, Float[np.ndarray, " N"]],
        observation: GroupObservation,
        driven: Bool[np.ndarray, "G N"],
    ) -> None:
        """Go on with other vehicles in the `changed` roles (by group).

        `ids` are the members of all groups, `lengths` [m] those of the members of changed groups, `driven` says which
        of them the policy still drives. `observation` has the new members. The place of a vehicle in the model's states
        depends on the lengths of the vehicles behind it in the group, so all places move.
        """
        offset = self.layout.offset.copy()
        for g, of in lengths.items():
            offset[g] = model_offsets(of[None], self.layout.order)[0]
        moved = offset - self.layout.offset
        self.layout = self.layout.with_members(offset, observation.state[..., _D])
        self._state, self._commanded = _farther(self._state, moved), _farther(self._commanded, moved)
        in_views = np.tile(moved, (self._channels.views, 1))
        self._window = deque((_farther(states, in_views) for states in self._window), self._window.maxlen)
        self._may_drive, self._mask = driven, None
        if self._guard is not None:
            self._guard.lookout.change_members(ids)
        graph, with_newcomers = self._memory.graph, self._with_newcomers
        for g, roles in changed.items():
            self._together_since[g] = observation.time
            if graph is not None and with_newcomers is not None:
                graph, with_them = on_same_pairs([graph, with_newcomers(graph, roles)])
                others = torch.arange(len(graph)) % len(self._state) != g
                graph = graph.where(others, with_them)
        if graph is not None:
            self._memory = replace(self._memory, graph=graph)
            self._record_graph(observation.time)

    def _no_action(self, observed: Float[np.ndarray, "V N D"]) -> Float[Tensor, "V N A"]:
        return torch.zeros(*observed.shape[:2], len(self._dynamics.action))

    @property
    def sees_nearby(self) -> bool:
        """Whether the policy looks at the vehicles around its groups."""
        return getattr(self._policy, "sees_nearby", False)

    def _act(self, state: Float[Tensor, "V N D"]) -> tuple[Float[Tensor, "V N A"], PolicyState]:
        """The policy's answer; one that looks at more than its groups is told who is near."""
        if isinstance(self._policy, FollowsNextAhead):
            return self._policy.act(self._memory, state, self._next_ahead())
        nearby = self.nearby_for_policy()
        if nearby is None:
            return self._policy.act(self._memory, state)
        act: Callable[..., tuple[Tensor, PolicyState]] = self._policy.act
        return act(self._memory, state, nearby)

    def _next_ahead(self) -> NextAhead | None:
        """Who is next ahead of each vehicle now, of those in no group, in each view."""
        if self._around is None:
            return None
        found, views = next_ahead(self._around, self.layout.pose(self._state)), self._channels.views
        return found if views == 1 else NextAhead(np.tile(found.gap, (views, 1)), np.tile(found.v, (views, 1)))

    def nearby_for_policy(self) -> Nearby | None:
        """Who is around the groups now, in each view; None for a policy that does not look at them."""
        if self._around is None or not self.sees_nearby:
            return None
        nearby = nearby_vehicles(self._around, self.layout.pose(self._state))
        return nearby if self._channels.views == 1 else nearby.repeated(self._channels.views)

    def _usable(self, action: Float[Tensor, "G N A"]) -> Float[Tensor, "G N A"]:
        """The action with 0 for what no vehicle can do; a group with such an action of a driven vehicle has failed."""
        if (np.abs(action.numpy()) <= LARGEST).all():
            return action
        right = (action.isfinite() & (action.abs() <= LARGEST)).all(-1)
        for g in (~right[:, self._driven_roles].all(-1)).nonzero()[:, 0].tolist():
            wrong = action[g, self._driven_roles][~right[g, self._driven_roles]][0].tolist()
            self._fail([g], f"act returned the action {wrong}, expected finite numbers of at most {LARGEST:g}")
        return action.where(right[..., None], 0.0)

    def _fail(self, groups: Iterable[int], reason: str) -> None:
        self.failures = {g: reason for g in groups} | self.failures

    def _of_own_view(self, action: Float[Tensor, "V N A"]) -> Float[Tensor, "G N A"]:
        """The action of each role from the view that drives it."""
        if self._channels.views == 1:
            return action
        views = action.unflatten(0, (self._channels.views, -1))
        return torch.stack([views[view, :, role] for role, view in enumerate(self._channels.view_of)], 1)

    def filter_use(self, group: int, end: float) -> FilterUse | None:
        """How the safety filter was used in a group that was driven until `end` [s]; None without one."""
        return None if self._guard is None else self._guard.use(group, self._driven_roles, end)

    def effects(self, group: int, end: float) -> list[Effect]:
        """What perturbed sensors and actuators did to a group that was driven until `end` [s]."""
        return self._channels.effects(group, max(round((end - self._took_over) / self._dt), 1))

    def _next_state(self, action: Float[np.ndarray, "G N A"]) -> Float[np.ndarray, "G N D"]:
        """The next state by the dynamics, within what the road surface allows; no vehicle drives backwards."""
        following = self.layout.in_bends(self._state, self._dynamics.step(self._state, action, self._dt))
        if not self._perfect:
            following = self._channels.feasible_state(torch.from_numpy(following)).numpy()
        if self._dynamics.stop is None or not (following[..., self._speed] < 0).any():  # few ever stand still
            return following
        return self._dynamics.stop(torch.from_numpy(self._state), torch.from_numpy(following)).numpy()

    def look_around(self, around: Around) -> None:
        """Read who is near the groups now."""
        self._around = around

    def observe(self, observation: GroupObservation, active: Sequence[int], around: Around | None = None) -> None:
        """Read the vehicles' new states; driven vehicles are where the dynamics put them."""
        self._around = around
        driven = self._driven(active)[..., None]
        self._state = np.where(driven, self._commanded, self.layout.states(observation.state))

    def with_commanded_acceleration(self, observation: GroupObservation, active: Sequence[int]) -> GroupObservation:
        """The observation with the dynamics' acceleration of driven vehicles; SUMO reports the past step's mean."""
        state = observation.state.copy()
        np.copyto(state[..., _A], self.pose.a, where=self._driven(active))
        return GroupObservation(observation.time, state, observation.valid, observation.rows)

    @property
    def numbers(self) -> tuple[FewVehicles, FewVehicles | None] | None:
        """What decides alone under the present graph, as numbers; None where anything else has a say in it.

        The second one follows the next vehicle ahead, in scenes of two, where the policy does.
        """
        if not self._perfect or self._guard or self.failures:
            return None
        if isinstance(self._policy, FollowsNextAhead):
            return self._policy.few_vehicles(self._memory)
        numbers = self._policy.few_vehicles(self._memory) if isinstance(self._policy, RelationalModel) else None
        return None if numbers is None else (numbers, None)

    @property
    def graph(self) -> InteractionGraph | None:
        """The graph that the policy drives under."""
        return self._memory.graph

    @property
    def every(self) -> int:
        """Steps between two actions of the policy."""
        return self._every

    def has_decided(self, now: Snapshot) -> bool:
        """Whether the next poses are decided on."""
        return self._decided_at == now.time

    @property
    def decisions_until_graph(self) -> int | None:
        """How many decisions come before the graph is inferred again; None if it never is."""
        return -self._steps % self._reinfer_steps if self._reinfer_steps else None

    def hand_over(self, core: RoundCore) -> int:
        """Let compiled code go on from here; returns the number of decisions so far."""
        pose = self.pose
        core.state[:], core.commanded[:], core.action[:] = self._state, self._commanded, self._action_now.numpy()
        core.pose[:] = pose.s, pose.d, pose.heading, pose.v, pose.a
        return self._steps

    def take_back(self, core: RoundCore, decisions: int, states: Float[np.ndarray, "M G N D"]) -> None:
        """Go on from where compiled code is after `decisions`, which were made in these states since `hand_over`."""
        if self._reinfer_steps:
            first = decisions - len(states)
            self._window.extend(state for k, state in enumerate(states, first) if k % self._every == 0)
        self._steps, self._state, self._commanded = decisions, core.state.copy(), core.commanded.copy()
        self._action_now, self.pose = torch.from_numpy(core.action.copy()), Pose(*core.pose.copy())

    def _driven(self, active: Sequence[int]) -> Bool[np.ndarray, "G N"]:
        """The vehicles that the policy drives, in the active groups."""
        if self._mask is None or self._mask[0] != active:
            mask = np.zeros(self._state.shape[:2], dtype=bool)
            mask[np.ix_(active, self._driven_roles)] = True
            if self._may_drive is not None:
                mask &= self._may_drive
            self._mask = list(active), mask
        return self._mask[1]


def _graph_of_views(graph: InteractionGraph, view_of: Sequence[int]) -> InteractionGraph:
    """One graph per group from those of its views: an effect on a vehicle as in the view that drives the vehicle."""
    views = max(view_of) + 1
    if views == 1:
        return graph
    logits = graph.logits.unflatten(0, (views, -1))
    own_view = [(view_of[receiver], k) for k, (_, receiver) in enumerate(graph.pairs)]
    of_receivers = torch.stack([logits[view, :, k] for view, k in own_view], 1)
    doubted = None
    if graph.in_doubt is not None:
        of_views = graph.in_doubt.unflatten(0, (views, -1))
        doubted = torch.stack([of_views[view, :, k] for view, k in own_view], 1)
    unknown = None if graph.unknown is None else graph.unknown.unflatten(0, (views, -1)).amax(0)
    return replace(graph, logits=of_receivers, unknown=unknown, in_doubt=doubted)


def _farther(states: Float[np.ndarray, "G N D"], way: Float[np.ndarray, "G N"]) -> Float[np.ndarray, "G N D"]:
    """The states with x farther by `way` [m]."""
    return np.concatenate([states[..., :1] + way[..., None].astype(states.dtype), states[..., 1:]], -1)


def _relative(state: Float[np.ndarray, "G N *T D"]) -> Float[Tensor, "G N *T D"]:
    """float32 states with x counted from the leader's latest position, where float32 is finest."""
    latest = state[:, -1:, 0] if state.ndim == 3 else state[:, -1:, -1:, 0]
    counted = state.copy()
    counted[..., 0] -= latest
    return torch.from_numpy(counted.astype(np.float32))
