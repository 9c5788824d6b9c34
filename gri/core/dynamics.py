"""How vehicles move: the transition operators of the paper (Sec. VI-C, VI-D) and their inverses.

`POINT_MASS_1D` is for car following, `DUBINS` for synthetic lane changing, `POINT_MASS_2D` for recorded lane changes.
Each `Dynamics` has two pure functions. `step` maps a state and an action to the next state. `inverse` maps two
successive states to the action between them: `inverse(x, step(x, a))` is `a`. Leading axes are free, and the last axis
holds the features in SI units.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.array_functions import cache_tensors, functions_for

State = Float[Tensor, "*batch D"]
Action = Float[Tensor, "*batch A"]
Array = TypeVar("Array", Tensor, np.ndarray)


@runtime_checkable
class Step(Protocol):
    """(state [*batch, D], action [*batch, A], dt [s]) -> next state [*batch, D], in torch or in numpy."""

    def __call__(self, state: Array, action: Array, dt: float, /) -> Array: ...


class DynamicsName(StrEnum):
    """Names of the dynamics, as in configurations and checkpoints."""

    POINT_MASS_1D = "point_mass_1d"
    DUBINS = "dubins"
    POINT_MASS_2D = "point_mass_2d"


@dataclass(frozen=True)
class Dynamics:
    """A transition operator with the names and units of its state and action features."""

    name: DynamicsName
    state: tuple[str, ...]
    state_units: tuple[str, ...]
    action: tuple[str, ...]
    action_units: tuple[str, ...]
    step: Step
    inverse: Callable[[Tensor, Tensor, float], Tensor]
    """(state, next state, dt) -> action."""
    stop: Callable[[Tensor, Tensor], Tensor] | None = None
    """(state, next state) -> next state of a vehicle that stops where it would reverse; None: it may reverse."""

    def index(self, feature: str) -> int:
        """Index of a state feature on the last axis; a `ValueError` if there is none of that name."""
        return self.state.index(feature)

    @property
    def speed(self) -> int:
        """Index of the speed on the last axis: along the road, or in the direction of travel."""
        return self.index("v" if "v" in self.state else "vx")


def _matrix_for(
    state: Tensor | np.ndarray, matrix: Callable[[float, torch.dtype], Tensor], dt: float
) -> Tensor | np.ndarray:
    """A transition matrix in the library and precision of the state; in numpy it is always in double precision."""
    return matrix(dt, torch.float64).numpy() if isinstance(state, np.ndarray) else matrix(dt, state.dtype)


@cache_tensors
def _point_mass_1d_matrix(dt: float, dtype: torch.dtype) -> Tensor:
    return torch.tensor([[1, dt, 0.5 * dt**2, 0], [0, 1, dt, 0], [0, 0, 1, dt]], dtype=dtype)


def _point_mass_1d_step(
    state: Float[Array, "*batch D"], action: Float[Array, "*batch A"], dt: float
) -> Float[Array, "*batch D"]:
    """x' = x + v·Δt + a·Δt²/2,  v' = v + a·Δt,  a' = a + δa·Δt  (Sec. VI-C)."""
    arrays = functions_for(state)
    return arrays.linear(arrays.join([state, action]), _matrix_for(state, _point_mass_1d_matrix, dt))


def _point_mass_1d_inverse(state: State, next_state: State, dt: float) -> Action:
    return (next_state[..., 2:] - state[..., 2:]) / dt


@cache_tensors
def _dubins_matrix(dt: float, dtype: torch.dtype) -> Tensor:
    """Rows x', y', v', θ', a', ω'; columns x, y, v, θ, a, ω, δa, δω, v·cosθ, v·sinθ."""
    matrix = torch.eye(6, 10, dtype=dtype)
    for row, column in ((0, 8), (1, 9), (2, 4), (3, 5), (4, 6), (5, 7)):
        matrix[row, column] = dt
    return matrix


def _dubins_step(
    state: Float[Array, "*batch D"], action: Float[Array, "*batch A"], dt: float
) -> Float[Array, "*batch D"]:
    """Dubins' car (Sec. VI-C).

    x' = x + v·cosθ·Δt,  y' = y + v·sinθ·Δt,  v' = v + a·Δt,
    θ' = θ + ω·Δt,       a' = a + δa·Δt,      ω' = ω + δω·Δt.
    """
    v, heading = state[..., 2:3], state[..., 3:4]
    arrays = functions_for(state)
    moved = arrays.join([state, action, v * arrays.cos(heading), v * arrays.sin(heading)])
    return arrays.linear(moved, _matrix_for(state, _dubins_matrix, dt))


def _dubins_inverse(state: State, next_state: State, dt: float) -> Action:
    return (next_state[..., 4:] - state[..., 4:]) / dt


def _point_mass_2d_step(
    state: Float[Array, "*batch 6"], action: Float[Array, "*batch 2"], dt: float
) -> Float[Array, "*batch 6"]:
    """Each axis moves as the 1-D point mass does (Sec. VI-D: the recorded data has no heading)."""
    position, v, a = state[..., :2], state[..., 2:4], state[..., 4:]
    return functions_for(state).join([position + v * dt + 0.5 * a * dt**2, v + a * dt, a + action * dt])


def stop_at_standstill(
    state: Float[Tensor, "*batch 3"], next_state: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch 3"]:
    """Stop a 1-D point mass that would reverse.

    The paper's equations have no standstill: in stop-and-go traffic, v' = v + a·Δt can become negative. The vehicle
    then stops after its remaining braking distance v²/(−2a), with v' = 0 and a' = 0.
    """
    x, v, a = state.unbind(-1)
    reversing = next_state[..., 1] < 0
    stopping_distance = torch.where(a < 0, v.clamp(min=0) ** 2 / (-2 * a).clamp(min=1e-6), torch.zeros_like(x))
    stopped = torch.stack([x + stopping_distance, torch.zeros_like(v), torch.zeros_like(a)], dim=-1)
    return torch.where(reversing[..., None], stopped, next_state)


def stop_dubins_at_standstill(
    state: Float[Tensor, "*batch 6"], next_state: Float[Tensor, "*batch 6"]
) -> Float[Tensor, "*batch 6"]:
    """Stop Dubins' car where it would reverse: v' = a' = ω' = 0, and θ' = θ. Its position moves with the speed v."""
    x, y, v, *_ = next_state.unbind(-1)
    zero = torch.zeros_like(v)
    stopped = torch.stack([x, y, zero, state[..., 3], zero, zero], -1)
    return torch.where((v < 0)[..., None], stopped, next_state)


POINT_MASS_1D = Dynamics(
    name=DynamicsName.POINT_MASS_1D,
    state=("x", "v", "a"),
    state_units=("m", "m/s", "m/s^2"),
    action=("jerk",),
    action_units=("m/s^3",),
    step=_point_mass_1d_step,
    inverse=_point_mass_1d_inverse,
    stop=stop_at_standstill,
)
"""Motion along one lane: state (x [m], v [m/s], a [m/s²]), action jerk [m/s³] (Sec. VI-C)."""
DUBINS = Dynamics(
    name=DynamicsName.DUBINS,
    state=("x", "y", "v", "heading", "a", "yaw_rate"),
    state_units=("m", "m", "m/s", "rad", "m/s^2", "rad/s"),
    action=("jerk", "yaw_acceleration"),
    action_units=("m/s^3", "rad/s^2"),
    step=_dubins_step,
    inverse=_dubins_inverse,
    stop=stop_dubins_at_standstill,
)
"""Motion in the plane: state (x, y [m], v [m/s], heading [rad], a [m/s²], yaw rate [rad/s]), action jerk [m/s³] and yaw
acceleration [rad/s²] (Sec. VI-C)."""
POINT_MASS_2D = Dynamics(
    name=DynamicsName.POINT_MASS_2D,
    state=("x", "y", "vx", "vy", "ax", "ay"),
    state_units=("m", "m", "m/s", "m/s", "m/s^2", "m/s^2"),
    action=("jerk_x", "jerk_y"),
    action_units=("m/s^3", "m/s^3"),
    step=_point_mass_2d_step,
    inverse=_dubins_inverse,  # the action is the rate of the last two features here as well
)

_BY_NAME = {dynamics.name: dynamics for dynamics in (POINT_MASS_1D, DUBINS, POINT_MASS_2D)}


def transition_matrix(dynamics: Dynamics, dt: float) -> Float[np.ndarray, "D I"] | None:
    """The matrix of `step` in double precision; None where there is none.

    It is applied to the state, the action and, for Dubins' car, v·cosθ and v·sinθ.
    """
    matrices = {DynamicsName.POINT_MASS_1D: _point_mass_1d_matrix, DynamicsName.DUBINS: _dubins_matrix}
    found = matrices.get(dynamics.name)
    return None if found is None else found(dt, torch.float64).numpy()


def dynamics_named(name: DynamicsName | str) -> Dynamics:
    """The dynamics of that name. Raises `ValueError` if there are none of that name."""
    return _BY_NAME[DynamicsName(name)]


def constant_speed(start: Float[Tensor, "B D"], steps: int, dynamics: Dynamics, dt: float) -> Float[Tensor, "B T D"]:
    """States of a vehicle that keeps its speed and drives straight on; T = `steps` + 1, with the start; `dt` in s."""
    constant = torch.tensor([float(name in ("x", "y", "v", "vx")) for name in dynamics.state])
    travelled = start[:, dynamics.speed, None] * torch.arange(steps + 1) * dt
    along = torch.eye(start.shape[1])[dynamics.index("x")]
    return (start * constant)[:, None] + travelled[..., None] * along
