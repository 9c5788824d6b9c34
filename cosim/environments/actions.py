"""What a learner's action means: the numbers from −1 to 1 that it gives, as actions of the project's dynamics.

Two kinds, for 1-D point masses (car following) and Dubins' car (merges):

- "targets": the acceleration, and in a merge the lateral position, that the vehicle shall have. The acceleration is
  reached within one step. The lateral position is approached as `gri.core.merging_policy.MergingDriver` does it.
- "dynamics": the actions of the paper's dynamics themselves, jerk and in a merge yaw acceleration (Sec. VI-C).
"""

from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Float

from gri.core.dynamics import Dynamics
from gri.core.merging_policy import MergingDriver
from gri.core.policy import IntelligentDriver
from gri.errors import InputError

ActionKind = Literal["targets", "dynamics"]
BRAKING, ACCELERATION = 5.0, 2.5
"""[m/s²] that the actions −1 and 1 mean; both scales meet at 0."""
LANE = 3.66
"""[m] to the right of the centre of the target lane: the lateral position that the action −1 means; 1 means this
centre."""
JERK, YAW_ACCELERATION = 15.0, 1.0
"""[m/s³], [rad/s²] that the action 1 means."""


def check_kind(kind: str) -> None:
    """Raise `InputError` for a kind that does not exist."""
    if kind not in get_args(ActionKind):
        raise InputError(f"action: got {kind!r}, expected one of {', '.join(get_args(ActionKind))}")


def action_of(
    given: Float[np.ndarray, "*batch A"],
    own: Float[np.ndarray, "*batch D"],
    kind: ActionKind,
    dynamics: Dynamics,
    dt: float,
) -> Float[np.ndarray, "*batch A"]:
    """The action of the dynamics for a vehicle of the state `own` over one step of `dt` [s]."""
    numbers = np.clip(given, -1.0, 1.0).astype(float)
    if kind == "dynamics":
        return numbers * np.array([JERK, YAW_ACCELERATION])[: len(dynamics.action)]
    a = own[..., dynamics.index("a")]
    target = np.where(numbers[..., 0] < 0, BRAKING, ACCELERATION) * numbers[..., 0]
    rates = [(target - a) / dt]
    if "heading" in dynamics.state:
        wanted = _yaw_rate_to(np.asarray(0.5 * LANE * (numbers[..., 1] - 1.0)), own, dynamics, dt)
        rates.append((wanted - own[..., dynamics.index("yaw_rate")]) / dt)
    return np.stack(rates, -1)


def _yaw_rate_to(
    desired_y: Float[np.ndarray, "*batch"], own: Float[np.ndarray, "*batch D"], dynamics: Dynamics, dt: float
) -> Float[np.ndarray, "*batch"]:
    """The yaw rate [rad/s] with which `MergingDriver` steers to a lateral position [m]."""
    y, v, heading = (torch.as_tensor(own[..., dynamics.index(name)]) for name in ("y", "v", "heading"))
    return MergingDriver(IntelligentDriver(dt)).yaw_rate_to(torch.as_tensor(desired_y), y, v, heading).numpy()
