"""Trajectory: the states of the vehicles of a scene over time."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor


@dataclass(frozen=True)
class Trajectory:
    """States of N vehicles at T instants, for B scenes.

    `state` has the layout of the dynamics that it is used with, in SI units. `valid` says which states exist; missing
    states are zeros. `dt` is the sampling time [s].
    """

    state: Float[Tensor, "B N T D"]
    valid: Bool[Tensor, "B N T"]
    dt: float

    def __post_init__(self) -> None:
        assert self.dt > 0, f"dt must be positive, got {self.dt}"
        assert self.state.shape[:3] == self.valid.shape, f"{self.state.shape} does not fit {self.valid.shape}"

    @classmethod
    def complete(cls, state: Float[Tensor, "B N T D"], dt: float) -> "Trajectory":
        """A trajectory in which every vehicle exists at every instant."""
        return cls(state, torch.ones(state.shape[:3], dtype=torch.bool, device=state.device), dt)

    @property
    def initial(self) -> Float[Tensor, "B N D"]:
        """The first states."""
        return self.state[:, :, 0]

    @property
    def final(self) -> Float[Tensor, "B N D"]:
        """The last states."""
        return self.state[:, :, -1]

    def __len__(self) -> int:
        """B, the number of scenes."""
        return self.state.shape[0]

    def __getitem__(self, scenes: Tensor | slice) -> "Trajectory":
        """The selected scenes."""
        return Trajectory(self.state[scenes], self.valid[scenes], self.dt)
