"""The Policy protocol and the policies that need no training.

A policy sees the history of B groups once (`begin`) and then, step by step, their current state (`act`).
Whoever runs it moves the vehicles with the policy's dynamics and decides which of them the action is applied
to.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri.core.dynamics import POINT_MASS_1D, Dynamics
from gri.core.graph import InteractionGraph
from gri.core.trajectory import Trajectory


@dataclass(frozen=True)
class PolicyState:
    """What a policy remembers of B groups: the graph it believes in and a memory; None: it has no notion of graphs.

    `memory` is whatever recurrent state the policy keeps, H = 0 where it keeps none.
    """

    graph: InteractionGraph | None
    memory: Float[Tensor, "B N H"]

    def __len__(self) -> int:
        return self.memory.shape[0]

    def __getitem__(self, groups: Int[Tensor, " G"] | slice) -> "PolicyState":
        return PolicyState(None if self.graph is None else self.graph[groups], self.memory[groups])

    @classmethod
    def concatenate(cls, states: Sequence["PolicyState"]) -> "PolicyState":
        """Join the groups of several states, in order."""
        graphs = [state.graph for state in states if state.graph is not None]
        graph = replace(graphs[0], logits=torch.cat([g.logits for g in graphs])) if graphs else None
        return cls(graph, torch.cat([state.memory for state in states]))


@runtime_checkable
class Policy(Protocol):
    """Anything that can drive groups."""

    @property
    def dynamics(self) -> Dynamics:
        """Layout of the states it reads and of the actions it gives."""
        ...

    @property
    def dt(self) -> float:
        """Time between two actions [s]."""
        ...

    @property
    def history_steps(self) -> int:
        """How many past states, the current one included, `begin` must be given."""
        ...

    def begin(self, history: Trajectory) -> PolicyState:
        """Watch the history of B groups; its last state is the one `act` is first called with."""
        ...

    def act(self, memory: PolicyState, state: Float[Tensor, "B N D"]) -> tuple[Float[Tensor, "B N A"], PolicyState]:
        """The (mean) action of every vehicle, and the memory for the next step."""
        ...


def _no_memory(history: Trajectory) -> PolicyState:
    return PolicyState(None, history.state.new_zeros(*history.state.shape[:2], 0))


@dataclass(frozen=True)
class ConstantVelocity:
    """Ends all acceleration (and turning) at once and keeps speed and heading.

    For dynamics whose actions are the rates of their last state features: the 1-D point mass and Dubins' car.
    """

    dt: float
    dynamics: Dynamics = POINT_MASS_1D
    history_steps: int = 1

    def begin(self, history: Trajectory) -> PolicyState:
        return _no_memory(history)

    def act(self, memory: PolicyState, state: Float[Tensor, "B N D"]) -> tuple[Float[Tensor, "B N A"], PolicyState]:
        return -state[..., -len(self.dynamics.action) :] / self.dt, memory


@dataclass(frozen=True)
class IntelligentDriver:
    """The intelligent driver model behind the nearest vehicle ahead in the group (Treiber et al. 2000).

    a = a_max·[1 − (v/v0)⁴ − (s*/s)²],  s* = s0 + max(0, v·T + v·Δv / (2√(a_max·b))), with the net gap s = Δx
    − length. The jerk brings next step's acceleration to that value. Defaults: means of the IDM population
    fitted to the US-101 recordings, `desired_speed` the 65 mph posted on California freeways.
    """

    dt: float
    length: float = 5.0  # [m], of the vehicle ahead
    desired_speed: float = 29.0  # [m/s]
    time_headway: float = 1.29  # [s]
    minimum_gap: float = 2.02  # [m]
    acceleration: float = 1.11  # [m/s^2]
    deceleration: float = 1.69  # [m/s^2], comfortable
    dynamics: Dynamics = POINT_MASS_1D
    history_steps: int = 1

    def begin(self, history: Trajectory) -> PolicyState:
        return _no_memory(history)

    def act(self, memory: PolicyState, state: Float[Tensor, "B N 3"]) -> tuple[Float[Tensor, "B N 1"], PolicyState]:
        x, v, a = state.unbind(-1)
        ahead = x[:, None, :] - x[:, :, None]  # Shape: (B, follower, leader)
        ahead = torch.where(ahead > 0, ahead, torch.inf)
        headway, leader = ahead.min(-1)
        target = self.target_acceleration(v, v.gather(1, leader), headway)
        return ((target - a) / self.dt)[..., None], memory

    def target_acceleration(
        self, v: Float[Tensor, "*batch"], v_ahead: Float[Tensor, "*batch"], headway: Float[Tensor, "*batch"]
    ) -> Float[Tensor, "*batch"]:
        """a [m/s²] at a headway [m], position to position, behind a vehicle; infinite: on an empty road."""
        gap = (headway - self.length).clamp(min=0.1)
        dynamic_gap = v * self.time_headway + v * (v - v_ahead) / (2 * (self.acceleration * self.deceleration) ** 0.5)
        wanted_gap = self.minimum_gap + dynamic_gap.clamp(min=0)
        interaction = torch.where(torch.isinf(headway), torch.zeros_like(gap), (wanted_gap / gap) ** 2)
        target = self.acceleration * (1 - (v / self.desired_speed) ** 4 - interaction)
        return target.clamp(min=-9.0)  # the road gives no more
