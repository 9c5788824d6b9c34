"""The intelligent driver model (IDM), fitted to recorded scenes: the usual baseline of traffic engineering."""

from dataclasses import fields, replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import minimize
from torch import Tensor

from gri.core.dynamics import stop_at_standstill
from gri.core.policy import IntelligentDriver
from gri.core.scenes import Scenes
from gri.core.trajectory import Trajectory
from gri.progress import Progress, no_progress
from gri.training.optimisation import reconstruction_loss

FITTED = {
    "desired_speed": (8.0, 45.0),
    "time_headway": (0.2, 3.0),
    "minimum_gap": (0.2, 8.0),
    "acceleration": (0.2, 4.0),
    "deceleration": (0.3, 6.0),
}
"""Fitted parameters and their bounds, in SI units (`gri.core.policy.IntelligentDriver`).

Spacings are front to front, so the vehicle ahead has the driver's fixed length of 5 m.
"""


@torch.no_grad()
def drive(
    driver: IntelligentDriver, start: Float[Tensor, "S N 3"], leader: Float[Tensor, "S T 3"]
) -> Float[Tensor, "S N T 3"]:
    """States [S, N, T, 3] (x [m], v [m/s], a [m/s²]) if the IDM drives all vehicles except the last.

    `leader` is the trajectory of the last vehicle. Vehicles do not reverse.
    """
    memory = driver.begin(Trajectory.complete(start[:, :, None], driver.dt))
    states = [start]
    for t in range(leader.shape[1] - 1):
        action, memory = driver.act(memory, states[-1])
        moved = stop_at_standstill(states[-1], driver.dynamics.step(states[-1], action, driver.dt))
        states.append(torch.cat([moved[:, :-1], leader[:, t + 1 : t + 2]], 1))
    return torch.stack(states, 2)


def calibrate(scenes: Scenes, dt: float, progress: Progress = no_progress) -> IntelligentDriver:
    """The IDM that minimises `reconstruction_loss`, the loss of the models, over all scenes (Nelder-Mead).

    `dt` is the time step [s].
    """
    driver = IntelligentDriver(dt)
    first = np.log([getattr(driver, name) for name in FITTED])
    bounds = [tuple(np.log(limits)) for limits in FITTED.values()]
    done = 0

    def loss(logarithms: np.ndarray) -> float:
        nonlocal done
        done += 1
        state = drive(with_parameters(driver, np.exp(logarithms)), scenes.start, scenes.leader)
        value = float(reconstruction_loss(state, scenes.state, driver.dynamics))
        progress("IDM", min(done, 400), 400, value)
        return value

    found = minimize(loss, first, method="Nelder-Mead", bounds=bounds, options={"maxfev": 400, "xatol": 1e-3})
    return with_parameters(driver, np.exp(found.x))


def with_parameters(driver: IntelligentDriver, values: np.ndarray) -> IntelligentDriver:
    """The driver with the given values of the fitted parameters, in the order of `FITTED`."""
    return replace(driver, **dict(zip(FITTED, map(float, values), strict=True)))


def parameters(driver: IntelligentDriver) -> dict[str, float]:
    """Names and values of the fitted parameters, rounded to three digits."""
    return {f.name: round(getattr(driver, f.name), 3) for f in fields(driver) if f.name in FITTED}
