"""A policy that a user wrote, called with care: whatever goes wrong in it is a `PolicyFailure` with a reason."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from cosim.process.guarded_calls import CallGuard, FatalCall
from gri.core.dynamics import Dynamics
from gri.core.graph import InteractionGraph
from gri.core.nearby import Nearby
from gri.core.policy import Policy, PolicyState
from gri.core.trajectory import Trajectory

SHORT = 200  # characters of what a policy says itself


class PolicyFailure(Exception):
    """A policy gave no usable answer; the message says why, and which method was called."""


@dataclass(frozen=True)
class OwnPolicy:
    """The policy of a user as a `gri.core.policy.Policy` that checks every answer.

    A call may take `limit` [s]; `guard` finds out about a call that ends or hangs the process.
    """

    policy: Policy
    limit: float
    guard: CallGuard = field(default_factory=CallGuard)

    @property
    def dynamics(self) -> Dynamics:
        return self.policy.dynamics

    @property
    def dt(self) -> float:
        return self.policy.dt

    @property
    def history_steps(self) -> int:
        return self.policy.history_steps

    def begin(self, history: Trajectory) -> PolicyState:
        """Read the history. Raises `PolicyFailure`."""
        state = self._call("begin", self.policy.begin, history)
        _check_state("begin", state, *history.state.shape[:2])
        return state

    @property
    def sees_nearby(self) -> bool:
        """Whether the policy is to be told who is near."""
        return bool(getattr(self.policy, "sees_nearby", False))

    def act(
        self, memory: PolicyState, state: Float[Tensor, "B N D"], *nearby: Nearby
    ) -> tuple[Float[Tensor, "B N A"], PolicyState]:
        """The actions and the next policy state; numbers in them may still be NaN. Raises `PolicyFailure`."""
        answer = self._call("act", self.policy.act, memory, state, *nearby)
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise PolicyFailure(f"act returned {_kind(answer)}, expected a pair (action, policy state)")
        action, following = answer
        wanted = (*state.shape[:2], len(self.dynamics.action))
        if not isinstance(action, Tensor):
            raise PolicyFailure(f"act returned {_kind(action)} as action, expected a tensor of shape {wanted}")
        if tuple(action.shape) != wanted:
            raise PolicyFailure(f"act returned an action of shape {tuple(action.shape)}, expected {wanted}")
        if action.is_complex() or action.dtype is torch.bool:
            raise PolicyFailure(f"act returned an action of {action.dtype}, expected real numbers")
        _check_state("act", following, *state.shape[:2])
        return action.detach().to("cpu", torch.float32), following

    def _call(self, method: str, function: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return self.guard.call(function, *arguments)
        except FatalCall as end:
            raise PolicyFailure(f"{method} {end}") from None
        except BaseException as error:  # whatever a user's code may raise, SystemExit included
            said = " ".join(str(error).split())[:SHORT]
            raise PolicyFailure(f"{method} raised {type(error).__name__}{said and ': '}{said}") from error


def _check_state(method: str, state: object, groups: int, vehicles: int) -> None:
    if not isinstance(state, PolicyState):
        raise PolicyFailure(f"{method} returned {_kind(state)} as policy state, expected a gri.PolicyState")
    graph: Any = state.graph
    if graph is None:
        return
    if not isinstance(graph, InteractionGraph):
        raise PolicyFailure(f"{method} returned {_kind(graph)} as graph, expected an InteractionGraph or None")
    pairs = vehicles * (vehicles - 1) if graph.candidates is None else len(graph.candidates)
    wanted = groups, pairs
    if tuple(graph.logits.shape[:2]) != wanted or not torch.isfinite(graph.logits).all():
        raise PolicyFailure(
            f"{method} returned a graph that is no finite logits of {wanted[0]} groups, {wanted[1]} pairs"
        )


def _kind(value: object) -> str:
    return "None" if value is None else f"a {type(value).__name__}"
