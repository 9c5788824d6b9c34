"""Car-following models from the literature, for scenes whose relations are known because they were simulated.

None of them is the learner's: no reward, network or constant is shared with `gri.rewards` or `gri.training`. Every
model is a pure function of what a driver perceives. Parameters are drawn for each driver. Speeds in m/s, gaps in m
(bumper to bumper), accelerations in m/s².
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

Value = Float[Tensor, "S N"]
Parameters = Mapping[str, Value]
FREE = 1e9  # [m], the gap of a driver without a leader
LEAST_GAP = 0.1  # [m], below which formulas that divide by the gap stop growing


@dataclass(frozen=True)
class DriverModel:
    """A car-following model: how parameters are drawn, and what a driver does."""

    name: str
    source: str
    ranges: Mapping[str, tuple[float, float]]
    """Range of each parameter; drawn uniformly and independently for each driver."""
    acceleration: Callable[[Parameters, Value, Value, Value], Value]
    """(parameters, own speed, gap, leader's speed) → acceleration; with gap `FREE` the driver keeps its own speed.

    The parameters include the wished speed `v0`, which the scene draws, not the model."""

    def draw(self, shape: tuple[int, int], generator: torch.Generator) -> dict[str, Value]:
        """Parameters of S × N drivers."""
        return {
            name: low + (high - low) * torch.rand(shape, generator=generator, dtype=torch.float64)
            for name, (low, high) in self.ranges.items()
        }


def _idm(p: Parameters, v: Value, gap: Value, leader: Value) -> Value:
    wanted = p["s0"] + (v * p["T"] + v * (v - leader) / (2 * (p["a"] * p["b"]).sqrt())).clamp(min=0)
    interaction = torch.where(gap < FREE, wanted / gap.clamp(min=LEAST_GAP), torch.zeros_like(gap))
    return p["a"] * (1 - (v / p["v0"].clamp(min=1.0)) ** 4 - interaction**2)


IDM = DriverModel(
    "idm",
    "intelligent driver model (Treiber, Hennecke, Helbing 2000)",
    {"a": (0.8, 2.0), "b": (1.2, 3.0), "T": (0.8, 2.0), "s0": (1.5, 3.5)},
    _idm,
)


def _fvdm(p: Parameters, v: Value, gap: Value, leader: Value) -> Value:
    """Optimal velocity V(s) = v0·(tanh(s/l − β) + tanh β) / (1 + tanh β), plus a term of the speed difference."""
    beta = torch.full_like(v, 1.5)
    wished = p["v0"].clamp(min=0) * (torch.tanh(gap / p["l"] - beta) + beta.tanh()) / (1 + beta.tanh())
    approach = torch.where(gap < FREE, p["lambda"] * (leader - v) / (1 + gap.clamp(max=FREE) / 100), 0.0)
    return p["kappa"] * (wished - v) + approach


FVDM = DriverModel(
    "fvdm",
    "full velocity difference model (Jiang, Wu, Zhu 2001)",
    {"kappa": (0.2, 0.5), "lambda": (0.3, 0.8), "l": (10.0, 25.0)},
    _fvdm,
)


def _gipps(p: Parameters, v: Value, gap: Value, leader: Value) -> Value:
    """The speed that is wished and the speed that is safe one reaction time later; the lower one counts."""
    tau, b = p["tau"], p["b"]
    ratio = v / p["v0"].clamp(min=1.0)
    wished = v + 2.5 * p["a"] * tau * (1 - ratio) * (0.025 + ratio).clamp(min=0).sqrt()
    room = (gap - p["s0"]).clamp(-20, 1e6)
    inside = (b * tau) ** 2 + b * (2 * room - v * tau + leader**2 / p["b_leader"])
    safe = torch.where(gap < FREE, -b * tau + inside.clamp(min=0).sqrt(), torch.full_like(gap, FREE))
    return ((torch.minimum(wished, safe) - v) / tau).clamp(-8, 3)


GIPPS = DriverModel(
    "gipps",
    "safe-distance model (Gipps 1981)",
    {"a": (0.8, 1.8), "b": (2.0, 4.0), "b_leader": (2.0, 4.0), "tau": (0.7, 1.3), "s0": (1.5, 3.5)},
    _gipps,
)


def _krauss(p: Parameters, v: Value, gap: Value, leader: Value) -> Value:
    """SUMO's default model without its imperfection, which the noise of the scene stands for."""
    room = (gap - p["s0"]).clamp(-20, 1e6)
    safe = leader + (room - leader * p["T"]) / ((v + leader) / (2 * p["b"]) + p["T"])
    wished = torch.minimum(v + p["a"] * p["T"], p["v0"])
    target = torch.where(gap < FREE, torch.minimum(wished, safe), wished)
    return ((target - v) / p["T"]).clamp(-p["b"] * 2, p["a"])


KRAUSS = DriverModel(
    "krauss",
    "stochastic safe-speed model (Krauß 1998)",
    {"a": (0.8, 2.0), "b": (2.0, 4.5), "T": (0.8, 1.6), "s0": (1.5, 3.5)},
    _krauss,
)


def _optimal_velocity(p: Parameters, v: Value, gap: Value, leader: Value) -> Value:
    """Without a speed difference: stable only because gaps are perceived late and sensitivities are moderate."""
    del leader
    wished = torch.minimum(p["v0"], ((gap - p["s0"]) / p["T"]).clamp(0, FREE))
    return p["kappa"] * (wished - v)


DELAYED_OVM = DriverModel(
    "delayed_ovm",
    "optimal-velocity model (Bando et al. 1995) with piecewise linear optimal velocity and a reaction delay",
    {"kappa": (0.3, 0.8), "T": (1.0, 2.2), "s0": (2.0, 4.0)},
    _optimal_velocity,
)


def _linear(p: Parameters, v: Value, gap: Value, leader: Value) -> Value:
    own = p["k0"] * (p["v0"] - v)
    following = p["k1"] * (gap - p["s0"] - p["T"] * v) + p["k2"] * (leader - v)
    return torch.where(gap < FREE, torch.minimum(following, own + 1.0), own)


LINEAR = DriverModel(
    "linear",
    "linear feedback of gap and speed difference (Helly 1959), the optimum of a quadratic cost",
    {"k0": (0.1, 0.4), "k1": (0.05, 0.25), "k2": (0.3, 0.9), "T": (0.9, 2.0), "s0": (2.0, 4.0)},
    _linear,
)

DRIVER_MODELS: tuple[DriverModel, ...] = (IDM, FVDM, GIPPS, KRAUSS, DELAYED_OVM, LINEAR)
