"""A policy at the wheel of several groups: what was seen in, one model call, where the vehicles will be out."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from cosim.loop.observation import Frame
from cosim.loop.state_layouts import Layout, Pose
from cosim.perturb.sensing_and_control import Signals
from cosim.world.episode import COLUMNS
from gri.core.graph import InteractionGraph
from gri.core.policy import Policy, PolicyState
from gri.core.trajectory import Trajectory

_A = COLUMNS.index("a")
GraphOverride = Callable[[InteractionGraph], InteractionGraph]


class PolicyRunner:
    """The model-frame state of all groups of a round and the policy's memory of them; to be used in inference mode.

    `owned` are the roles that it drives, `reinfer` [steps] how often it infers the graph anew (0: never again),
    `overrule` what is made of the inferred graph before it counts, `signals` what lies between it and the world.
    """

    def __init__(
        self,
        policy: Policy,
        layout: Layout,
        history: Sequence[Frame],
        owned: Sequence[int],
        dt: float,
        overrule: GraphOverride,
        reinfer: int = 0,
        signals: Signals | None = None,
    ) -> None:
        assert policy.dynamics.name is layout.dynamics.name, f"cannot drive {policy.dynamics.name} states here"
        self._policy, self._layout, self._dt = policy, layout, dt
        self._dynamics, self._speed = policy.dynamics, policy.dynamics.speed
        self._owned, self._overrule, self._reinfer, self._signals = list(owned), overrule, reinfer, signals
        self._mask: tuple[list[int], np.ndarray] | None = None  # active groups, and who is driven in them
        self._window = deque((layout.states(frame.state) for frame in history), policy.history_steps)
        self._state = self._commanded = self._window[-1]
        self._pose = layout.pose(self._commanded)
        self._steps = 0
        self._memory = self._begin()
        self.graphs: list[tuple[float, InteractionGraph]] = []
        self._note(history[-1].time)

    def _begin(self) -> PolicyState:
        """The policy's memory of the window, under the graph that counts."""
        states = _relative(np.stack(self._window, axis=2))
        memory = self._policy.begin(Trajectory.complete(states, self._dt))
        return memory if memory.graph is None else replace(memory, graph=self._overrule(memory.graph))

    def _note(self, time: float) -> None:
        if self._memory.graph is not None:
            self.graphs.append((time, self._memory.graph))

    def place(self, frame: Frame) -> None:
        """Put the vehicles where they are in this frame, whatever the policy saw of them before."""
        self._state = self._commanded = self._layout.states(frame.state)

    def decide(self, time: float) -> Pose:
        """Ask the policy and move the dynamics one step on: where the vehicles are to be after the next step."""
        seen = self._state
        if self._signals is not None:
            seen = self._signals.see(self._steps, torch.from_numpy(seen)).numpy()
        if self._reinfer and self._steps:
            self._window.append(seen)
        if self._reinfer and self._steps and self._steps % self._reinfer == 0:
            self._memory = replace(self._memory, graph=self._begin().graph)
            self._note(time)
        action, self._memory = self._policy.act(self._memory, _relative(seen))
        if self._signals is not None:
            action = self._signals.apply(self._steps, action)
        self._commanded = self._move(action.numpy().astype(float))
        self._steps += 1
        self._pose = self._layout.pose(self._commanded)
        return self._pose

    def _move(self, action: Float[np.ndarray, "G 3 A"]) -> Float[np.ndarray, "G 3 D"]:
        """The next state by the dynamics, within what the road allows; nobody drives backwards."""
        following = self._dynamics.step(self._state, action, self._dt)
        if self._signals is not None:
            following = self._signals.bound(torch.from_numpy(following)).numpy()
        if self._dynamics.stop is None or not (following[..., self._speed] < 0).any():  # few ever stand still
            return following
        return self._dynamics.stop(torch.from_numpy(self._state), torch.from_numpy(following)).numpy()

    def observe(self, frame: Frame, active: Sequence[int]) -> None:
        """Read the world; the vehicles that are driven are where the dynamics put them."""
        driven = self._driven(active)[..., None]
        self._state = np.where(driven, self._commanded, self._layout.states(frame.state))

    def stamp(self, frame: Frame, active: Sequence[int]) -> Frame:
        """The frame with the dynamics' acceleration of owned vehicles; SUMO reports the past step's mean instead."""
        state = frame.state.copy()
        np.copyto(state[..., _A], self._pose.a, where=self._driven(active))
        return Frame(frame.time, state, frame.valid, frame.rows)

    def _driven(self, active: Sequence[int]) -> Bool[np.ndarray, "G 3"]:
        """Whose state the policy decides on, of the groups that are driven."""
        if self._mask is None or self._mask[0] != active:
            mask = np.zeros(self._state.shape[:2], dtype=bool)
            mask[np.ix_(active, self._owned)] = True
            self._mask = list(active), mask
        return self._mask[1]


def _relative(state: Float[np.ndarray, "G 3 *T D"]) -> Float[Tensor, "G 3 *T D"]:
    """float32 states with x counted from the leader's latest position, where float32 is finest."""
    latest = state[:, 2:3, 0] if state.ndim == 3 else state[:, 2:3, -1:, 0]
    counted = state.copy()
    counted[..., 0] -= latest
    return torch.from_numpy(counted.astype(np.float32))
