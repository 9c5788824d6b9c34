"""The Policy protocol, and two policies that need no training: constant velocity and the intelligent driver model.

A policy reads the history of B groups once (`begin`), and then at each step their current states (`act`). The caller
moves the vehicles with the policy's dynamics, and decides to which of them an action is applied.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri.core.dynamics import POINT_MASS_1D, Dynamics
from gri.core.graph import InteractionGraph
from gri.core.nearby import Nearby
from gri.core.trajectory import Trajectory


@dataclass(frozen=True)
class PolicyState:
    """What a policy keeps from step to step for B groups of N vehicles."""

    graph: InteractionGraph | None
    """The graph under which it drives; None for a policy without a graph."""
    memory: Float[Tensor, "B N H"]
    """Hidden state per vehicle; H = 0 for a policy without one."""

    @classmethod
    def empty(cls, history: Trajectory) -> "PolicyState":
        """The state of a policy with neither graph nor hidden state."""
        return cls(None, history.state.new_zeros(*history.state.shape[:2], 0))

    def __len__(self) -> int:
        """B, the number of groups."""
        return self.memory.shape[0]

    def __getitem__(self, groups: Int[Tensor, " G"] | slice) -> "PolicyState":
        """The state of the selected groups."""
        return PolicyState(None if self.graph is None else self.graph[groups], self.memory[groups])

    @classmethod
    def concatenate(cls, states: Sequence["PolicyState"]) -> "PolicyState":
        """Join the groups of several states, in order."""
        graphs = [state.graph for state in states if state.graph is not None]
        graph = replace(graphs[0], logits=torch.cat([g.logits for g in graphs])) if graphs else None
        return cls(graph, torch.cat([state.memory for state in states]))


@runtime_checkable
class Policy(Protocol):
    """Anything that drives groups of vehicles.

    A policy with an attribute `sees_nearby` that is true gets a third argument in `act`: the vehicles around the groups
    (`gri.core.nearby.Nearby`), as they are at present.
    """

    @property
    def dynamics(self) -> Dynamics:
        """Layout and units of the states it reads and of the actions it gives."""
        ...

    @property
    def dt(self) -> float:
        """Time between two actions [s]."""
        ...

    @property
    def history_steps(self) -> int:
        """Number of past states, with the current one, that `begin` needs."""
        ...

    def begin(self, history: Trajectory) -> PolicyState:
        """Read the history of B groups. Its last state is the first state that `act` is called with."""
        ...

    def act(self, memory: PolicyState, state: Float[Tensor, "B N D"]) -> tuple[Float[Tensor, "B N A"], PolicyState]:
        """The mean action of every vehicle in SI units, and the policy state for the next step."""
        ...


@dataclass(frozen=True)
class ConstantVelocity:
    """A policy that keeps speed and heading: it brings acceleration and yaw rate to 0 in one step.

    For dynamics whose actions are the rates of their last state features: the 1-D point mass and Dubins' car.
    """

    dt: float
    """Time between two actions [s]."""
    dynamics: Dynamics = POINT_MASS_1D
    history_steps: int = 1

    def begin(self, history: Trajectory) -> PolicyState:
        """Nothing to infer."""
        return PolicyState.empty(history)

    def act(self, memory: PolicyState, state: Float[Tensor, "B N D"]) -> tuple[Float[Tensor, "B N A"], PolicyState]:
        return -state[..., -len(self.dynamics.action) :] / self.dt, memory


@dataclass(frozen=True)
class IntelligentDriver:
    """The intelligent driver model (Treiber et al. 2000) behind the nearest vehicle ahead in the group.

    a = a_max·[1 − (v/v0)⁴ − (s*/s)²],  s* = s0 + max(0, v·T + v·Δv / (2√(a_max·b))), with the net gap s = Δx − length.
    The jerk brings the acceleration of the next step to this value. The defaults are means over IDM drivers fitted to
    the US-101 recordings; the desired speed is the speed limit of California freeways, 65 mph.
    """

    dt: float
    """Time between two actions [s]."""
    length: float = 5.0
    """Length of the vehicle ahead [m]."""
    desired_speed: float = 29.0
    """v0 [m/s]."""
    time_headway: float = 1.29
    """T [s]."""
    minimum_gap: float = 2.02
    """s0 [m]."""
    acceleration: float = 1.11
    """a_max [m/s²]."""
    deceleration: float = 1.69
    """b, the comfortable deceleration [m/s²]."""
    sees_nearby: bool = False
    """Also behind vehicles that are not in the group, where the caller says who is near."""
    dynamics: Dynamics = POINT_MASS_1D
    history_steps: int = 1

    def begin(self, history: Trajectory) -> PolicyState:
        """Nothing to infer."""
        return PolicyState.empty(history)

    def act(
        self, memory: PolicyState, state: Float[Tensor, "B N 3"], nearby: Nearby | None = None
    ) -> tuple[Float[Tensor, "B N 1"], PolicyState]:
        x, v, a = state.unbind(-1)
        ahead = x[:, None, :] - x[:, :, None]  # Shape: (B, follower, leader)
        ahead = torch.where(ahead > 0, ahead, torch.inf)
        headway, leader = ahead.min(-1)
        target = self.target_acceleration(v, v.gather(1, leader), headway)
        if nearby is not None:
            target = torch.minimum(target, self.behind_others(v, nearby))
        return ((target - a) / self.dt)[..., None], memory

    def behind_others(self, v: Float[Tensor, "B N"], nearby: Nearby) -> Float[Tensor, "B N"]:
        """a [m/s²] behind the next vehicle ahead that is in the path and not in the group."""
        gap, v_ahead = nearby.next_ahead()
        return self.target_acceleration(v, v_ahead, gap + self.length)

    def target_acceleration(
        self, v: Float[Tensor, "*batch"], v_ahead: Float[Tensor, "*batch"], headway: Float[Tensor, "*batch"]
    ) -> Float[Tensor, "*batch"]:
        """a [m/s²], at least −9, behind a vehicle at a headway [m] between positions; inf is an empty road."""
        gap = (headway - self.length).clamp(min=0.1)
        dynamic_gap = v * self.time_headway + v * (v - v_ahead) / (2 * (self.acceleration * self.deceleration) ** 0.5)
        desired_gap = self.minimum_gap + dynamic_gap.clamp(min=0)
        interaction = torch.where(torch.isinf(headway), torch.zeros_like(gap), (desired_gap / gap) ** 2)
        target = self.acceleration * (1 - (v / self.desired_speed) ** 4 - interaction)
        return target.clamp(min=-9.0)  # [m/s²], the friction limit of the road
