"""Networks that are taught the relations of merges: one frame (geometry), or the whole scene (the ceiling).

Both see differences of positions in lane widths and metres, speeds, and the order of the vehicles, never the step's
number. Features do not depend on the site.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gri.bench.merge_scenes import PAIRS, MergeScenes
from gri.core.edges import LANE_CHANGING
from gri.relations.broken_merges import V, X, Y

K, E = len(LANE_CHANGING), len(PAIRS)


def frame_features(scenes: MergeScenes) -> Float[Tensor, "S C T"]:
    """What is seen of each step, scaled to about one."""
    x, y, v = (scenes.state[..., k] for k in (X, Y, V))
    a = (v[..., 1:] - v[..., :-1]) / scenes.dt
    a = torch.cat([a, a[..., -1:]], -1)
    across = (y - y[:, -1:, :1]) / scenes.lane_width
    parts = []
    for i, j in PAIRS:
        if i < j:
            gap = x[:, i] - x[:, j]
            length = scenes.length[:, i, None].where(gap > 0, scenes.length[:, j, None])
            net = (gap.abs() - length) * gap.sign()
            parts += [gap / 20, net / 20, (net / 5).tanh(), (v[:, i] - v[:, j]) / 3]
            parts += [(net / (v[:, i].minimum(v[:, j]) + 2) / 2).tanh(), (across[:, i] - across[:, j])]
    for k in range(3):
        moved = torch.cat([torch.zeros_like(across[:, k, :1]), across[:, k, 1:] - across[:, k, :-1]], -1)
        parts += [v[:, k] / 15, a[:, k] / 2, across[:, k], 10 * moved, (a[:, k].abs() < 0.02).to(a.dtype)]
    return torch.stack(parts, 1).float()


class StepClassifier(nn.Module):
    """Logits of every pair's relation in every step, and of the scene; a kernel of 1 sees single frames."""

    def __init__(self, channels: int, kernel: int, hidden: int = 96) -> None:
        super().__init__()
        layers: list[nn.Module] = [nn.BatchNorm1d(channels)]
        width = channels
        for dilation in (1, 2, 4, 8):
            dilated = dilation if kernel > 1 else 1
            layers += [nn.Conv1d(width, hidden, kernel, padding="same", dilation=dilated), nn.SiLU(), nn.Dropout(0.1)]
            width = hidden
        self.series = nn.Sequential(*layers)
        self.step = nn.Conv1d(hidden, E * K, 1)
        self.scene = nn.Linear(2 * hidden, E * K)

    def forward(self, features: Float[Tensor, "B C T"]) -> tuple[Float[Tensor, "B T E K"], Float[Tensor, "B E K"]]:
        series = self.series(features)
        pooled = torch.cat([series.mean(-1), series.amax(-1)], -1)
        steps = self.step(series).reshape(len(series), E, K, -1).permute(0, 3, 1, 2)
        return steps, self.scene(pooled).reshape(-1, E, K)


def teach(
    features: Float[Tensor, "S C T"],
    steps: Int[Tensor, "S T E"] | Float[Tensor, "S T E K"],
    graph: Int[Tensor, "S E"],
    kernel: int,
    seed: int,
    updates: int = 500,
    batch: int = 32,
) -> StepClassifier:
    """A classifier taught relations per step and per scene by cross-entropy."""
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    model = StepClassifier(features.shape[1], kernel).train()
    optimiser = torch.optim.AdamW(model.parameters(), 3e-3, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 3e-3, total_steps=updates)
    for _ in range(updates):
        rows = torch.randint(len(features), (batch,), generator=generator)
        per_step, per_scene = model(features[rows])
        loss = nn.functional.cross_entropy(per_step.flatten(0, 2), steps[rows].flatten(0, 2))
        loss = loss + 0.3 * nn.functional.cross_entropy(per_scene.flatten(0, 1), graph[rows].flatten())
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return model.eval()
