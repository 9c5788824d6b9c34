"""Classifiers that are taught the true relations: the ceiling of the benchmark, and the geometry of a single frame.

Both give each receiver a softmax over {nobody, candidate k ahead}, so that at most one vehicle is followed.
"""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from gri.bench.car_following_scenes import LENGTH, KnownScenes, accelerations
from gri.core.edges import pairs

CHANNELS = 7


def pair_features(state: Float[Tensor, "S N T 3"]) -> Float[Tensor, "S N N C T"]:
    """What a classifier sees of receiver j and candidate k over time, scaled to about one; [scene, j, k]."""
    x, v = state[..., 0], state[..., 1]
    a = torch.zeros_like(v)
    a[..., 1:] = accelerations(v)
    receiver, candidate = (slice(None), slice(None), None), (slice(None), None)
    gap = x[candidate] - x[receiver] - LENGTH
    own = v[receiver].expand_as(gap)
    channels = [
        gap / 50,
        (gap / (own + 3)).clamp(-20, 20) / 5,
        (v[candidate] - v[receiver]) / 3,
        own / 20,
        a[receiver].expand_as(gap),
        a[candidate].expand_as(gap),
        10 / gap.clamp(min=1),
    ]
    return torch.stack(channels, 3).float()


def candidates_ahead(state: Float[Tensor, "S N T 3"]) -> Bool[Tensor, "S N N"]:
    """Which vehicles [scene, j, k] are ahead of which at first."""
    x = state[:, :, 0, 0]
    return x[:, None, :] > x[:, :, None]


class PairClassifier(nn.Module):
    """Convolutions over time for each pair, pooled, then one score per candidate and one for "nobody"."""

    def __init__(self, hidden: int = 32) -> None:
        super().__init__()
        self.series = nn.Sequential(
            nn.Conv1d(CHANNELS, hidden, 5, padding=2),
            nn.SiLU(),
            nn.Conv1d(hidden, hidden, 5, padding=2),
            nn.SiLU(),
            nn.Conv1d(hidden, hidden, 5, padding=2, stride=2),
            nn.SiLU(),
        )
        self.answer = nn.Sequential(nn.Linear(2 * hidden, hidden), nn.SiLU(), nn.Linear(hidden, 2))

    def forward(self, features: Float[Tensor, "B N N C T"], ahead: Bool[Tensor, "B N N"]) -> Float[Tensor, "B N 1+N"]:
        """Logits over {nobody, candidate k} for each receiver."""
        series = self.series(features.flatten(0, 2))
        pooled = torch.cat([series.mean(-1), series.amax(-1)], -1)
        score = self.answer(pooled).reshape(*ahead.shape, 2)
        follow = score[..., 0].masked_fill(~ahead, -1e9)
        nobody = (score[..., 1] * ahead).sum(-1, keepdim=True) / ahead.sum(-1, keepdim=True).clamp(min=1)
        return torch.cat([nobody, follow], -1)


def train_classifier(
    scenes: Sequence[KnownScenes], see: Callable[[Tensor], Tensor], seed: int, updates: int, batch: int = 128
) -> Callable[[KnownScenes], Float[Tensor, "S E"]]:
    """Teach a classifier the relations of scenes; `see` takes from the states [S, N, T, 3] what it may see."""
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    state = torch.cat([see(known.state) for known in scenes])
    leader = torch.cat([known.leader for known in scenes])
    features, ahead, target = (
        pair_features(state),
        candidates_ahead(state),
        (leader + 1).clamp(min=0),
    )  # 0 is nobody of the scene
    model = PairClassifier()
    optimiser = torch.optim.Adam(model.parameters(), 3e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 3e-3, total_steps=updates)
    for _ in range(updates):
        rows = torch.randint(len(state), (batch,), generator=generator)
        logits = model(features[rows], ahead[rows])
        chosen = ahead[rows].any(-1)  # the foremost vehicle has nothing to choose
        loss = nn.functional.cross_entropy(logits[chosen], target[rows][chosen])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    model.eval()

    @torch.no_grad()
    def infer(known: KnownScenes) -> Float[Tensor, "S E"]:
        seen = see(known.state)
        shares = model(pair_features(seen), candidates_ahead(seen)).softmax(-1)[..., 1:].double()
        return torch.stack([shares[:, j, i] for i, j in pairs(shares.shape[1])], 1)

    return infer
