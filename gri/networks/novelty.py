"""How far scenes are from those that a model was trained on: the score behind "I do not know".

Each vehicle with one ahead is described by a few facts of the last seconds: speed, gap, how they change, how much both
vehicles accelerate, how jerky the vehicle is, and whether its positions fit its speeds. The score of a scene is the
distance of its strangest vehicle to its nearest neighbours among the training scenes. It is divided by a threshold that
`EXCEEDING` of the validation scenes are above. So scenes above 1 are unknown. It says nothing about the graph itself.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

FACTS = 8
NEIGHBOURS = 3
EXCEEDING = 0.01  # share of validation scenes above the threshold


class Novelty(nn.Module):
    """Distances to M vehicles of the training scenes.

    The facts have floors (accelerations .1 m/s², jerks .5 m/s³, slips .1 m), below which differences are those of
    integrators and not of worlds.
    """

    reference: Tensor
    centre: Tensor
    unit: Tensor
    threshold: Tensor

    def __init__(self, size: int, speed: int, dt: float) -> None:
        """`size`: M; `speed`: index of the speed among the state features; dt [s]."""
        super().__init__()
        self.speed, self.dt = speed, dt
        self.register_buffer("reference", torch.zeros(size, FACTS))
        self.register_buffer("centre", torch.zeros(FACTS))
        self.register_buffer("unit", torch.ones(FACTS))
        self.register_buffer("threshold", torch.full((), torch.inf))

    @torch.no_grad()
    def fit(self, state: Float[Tensor, "S N T D"], generator: torch.Generator) -> None:
        """Take the reference from three quarters of the scenes, drawn at random, and the threshold from the others."""
        state = state[torch.randperm(len(state), generator=generator)]
        facts = self._facts(state)
        split = max(1, 3 * len(facts) // 4)
        known = facts[:split].flatten(0, 1)
        self.centre.copy_(known.mean(0))
        self.unit.copy_(known.std(0).clamp(min=1e-3))
        rows = torch.randint(len(known), (len(self.reference),), generator=generator)
        self.reference.copy_((known[rows] - self.centre) / self.unit)
        self.threshold.fill_(1.0)
        self.threshold.copy_(self(state[split:]).quantile(1 - EXCEEDING).clamp(min=1e-6))

    @torch.no_grad()
    def forward(self, state: Float[Tensor, "B N T D"]) -> Float[Tensor, " B"]:
        """The score of each scene; above 1 it is unknown. Zero where `fit` was never called."""
        facts = (self._facts(state) - self.centre) / self.unit
        distance = torch.cdist(facts.flatten(0, 1), self.reference)
        near = distance.topk(min(NEIGHBOURS, distance.shape[1]), largest=False).values.mean(-1)
        return near.reshape(facts.shape[:2]).amax(1) / self.threshold

    def _facts(self, state: Float[Tensor, "B N T D"]) -> Float[Tensor, "B N-1 F"]:
        order = state[:, :, -1, 0].argsort(1)
        index = order[:, :, None].expand(-1, -1, state.shape[2])
        x, v = state[..., 0].gather(1, index), state[..., self.speed].gather(1, index)
        a = (v[..., 1:] - v[..., :-1]) / self.dt
        jerk = (a[..., 1:] - a[..., :-1]) / self.dt
        slip = x[..., 1:] - x[..., :-1] - (v[..., 1:] + v[..., :-1]) / 2 * self.dt

        def size(series: Tensor, floor: float) -> Tensor:
            return (series.square().mean(-1) + floor**2).log() / 2

        gap = (x[:, 1:] - x[:, :-1]).clamp(min=1.0)
        facts = [
            v[:, :-1].mean(-1) / 5,
            gap.mean(-1).log(),
            (v[:, 1:] - v[:, :-1]).mean(-1) / 2,
            gap[..., -1].log() - gap[..., 0].log(),
            size(a[:, :-1], 0.1),
            size(a[:, 1:], 0.1),
            size(jerk[:, :-1], 0.5),
            size(slip[:, :-1], 0.1),
        ]
        return torch.stack(facts, -1)
