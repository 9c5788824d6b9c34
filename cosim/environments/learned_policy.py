"""Driving with what a learner learned: its function from observations to actions as a `gri.core.policy.Policy`.

`LearnedPolicy` takes any such function. `save_network` writes one that is a small network to a file without code, and
`network_policy` reads it, so that scenarios, stress tests and batches can name it:

    policy: {kind: python, object: "cosim.environments.learned_policy:network_policy", settings: {file: ppo.npz}}
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cosim.environments.actions import ActionKind, action_of, check_kind
from cosim.environments.observation import ObservationKind, check_seen, names_of, observe
from cosim.world.road_frame import NOMINAL_LENGTH
from gri.core.dynamics import POINT_MASS_1D, Dynamics, dynamics_named
from gri.core.merging_policy import MergingDriver
from gri.core.nearby import Nearby
from gri.core.policy import IntelligentDriver, Policy, PolicyState
from gri.core.trajectory import Trajectory
from gri.errors import InputError

Predict = Callable[[Float[np.ndarray, "B F"]], Float[np.ndarray, "B A"]]
_FORMAT = 1  # of the files


@dataclass(frozen=True)
class LearnedPolicy:
    """Drives the vehicle of `role` by `predict`, which gets observations and gives actions from −1 to 1.

    All other vehicles are driven by the intelligent driver model, in a merge by `MergingDriver`, where the scenario
    lets the policy drive them.
    """

    predict: Predict
    dt: float
    """Time between two actions [s]."""
    dynamics: Dynamics
    role: int = 0
    action: ActionKind = "targets"
    sees: ObservationKind = "group"
    name: str = "learned"
    history_steps: int = 1

    @property
    def sees_nearby(self) -> bool:
        """Whether it looks at more than its group."""
        return self.sees == "everybody"

    @property
    def others(self) -> Policy:
        """The policy of the other vehicles."""
        driver = IntelligentDriver(self.dt, length=NOMINAL_LENGTH)
        return driver if self.dynamics is POINT_MASS_1D else MergingDriver(driver)

    def begin(self, history: Trajectory) -> PolicyState:
        """Nothing to infer."""
        return PolicyState.empty(history)

    def act(
        self, memory: PolicyState, state: Float[Tensor, "B 3 D"], nearby: Nearby | None = None
    ) -> tuple[Float[Tensor, "B 3 A"], PolicyState]:
        actions, _ = self.others.act(memory, state)
        states = state.numpy()
        given = self.predict(observe(states, self.role, self.dynamics, nearby if self.sees_nearby else None))
        own = action_of(given, states[:, self.role].astype(float), self.action, self.dynamics, self.dt)
        actions[:, self.role] = torch.from_numpy(own.astype(np.float32))
        return actions, memory


def save_network(
    path: str | Path,
    layers: Sequence[tuple[np.ndarray, np.ndarray]],
    *,
    dynamics: str,
    dt: float,
    role: int = 0,
    action: ActionKind = "targets",
    sees: ObservationKind = "group",
    name: str = "learned",
) -> None:
    """Write a network of linear layers with tanh between them: weights of shape (out, in), and biases.

    Args:
        path: the file, usually named `.npz`.
        layers: of the network from an observation to the mean action.
        dynamics: "dubins" for merges, "point_mass_1d" for car following.
        dt: the step [s] of the environment in which it was trained.
        role: the vehicle that it drives.
        action: the kind of its actions.
        sees: the kind of its observations.
        name: of the policy, in tables.
    """
    check_kind(action)
    check_seen(sees)
    about = {"format": _FORMAT, "dynamics": dynamics, "dt": dt, "role": role, "action": action, "sees": sees}
    about["name"] = name
    arrays = {"about": np.array(json.dumps(about))}
    for k, (weight, bias) in enumerate(layers):
        arrays |= {f"w{k}": weight, f"b{k}": bias}
    with Path(path).open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def network_policy(dt: float, file: str) -> LearnedPolicy:
    """The policy of a file that `save_network` wrote. Raises `InputError` where it is none, or is for another step."""
    try:
        with np.load(file, allow_pickle=False) as found:
            about = json.loads(str(found["about"]))
            layers = [
                (found[f"w{k}"].astype(float), found[f"b{k}"].astype(float)) for k in range((len(found.files) - 1) // 2)
            ]
        dynamics = dynamics_named(about["dynamics"])
        sizes = [layers[0][0].shape[1], *(weight.shape[0] for weight, _ in layers)]
        sees = about.get("sees", "group")  # files of version 0.1 do not say it
        check_seen(sees)
        wanted = len(names_of(about["role"], dynamics, sees)), len(dynamics.action)
    except FileNotFoundError:
        raise InputError(f"settings.file: no file {file!r} (looked in {Path.cwd()}); give the path of one") from None
    except Exception as error:  # whatever a file of another kind leads to
        raise InputError(
            f"{file}: not a file of save_network ({type(error).__name__}: {error}); save it anew"
        ) from error
    if about.get("format") != _FORMAT or (sizes[0], sizes[-1]) != wanted:
        raise InputError(
            f"{file}: got a network of {sizes[0]} to {sizes[-1]} numbers, expected {wanted[0]} to {wanted[1]}"
        )
    if abs(about["dt"] - dt) > 1e-9:
        raise InputError(f"step: got {dt:g} s, {file} was trained with {about['dt']:g} s; set step to that")

    def predict(observation: Float[np.ndarray, "B F"]) -> Float[np.ndarray, "B A"]:
        value = observation.astype(float)
        for k, (weight, bias) in enumerate(layers):
            value = value @ weight.T + bias
            value = np.tanh(value) if k < len(layers) - 1 else value
        return value

    return LearnedPolicy(predict, dt, dynamics, about["role"], about["action"], sees, about["name"])
