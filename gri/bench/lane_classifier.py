"""Classifiers that are taught the relations of every step: the ceiling of the lane benchmark, and single frames."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from gri.bench.lane_families import FIRST
from gri.bench.lane_scenes import LaneScenes, balanced_steps, joined, pairs_that_may_react
from gri.core.edges import LANE_CHANGING, pairs

CHANNELS = 11
DILATIONS = (1, 2, 4, 8)  # kernels of five steps see 6 s to both sides
BATCH = 24  # scenes
MOST = 0.55  # share of the most frequent type of each pair in what is taught and scored
See = Callable[[LaneScenes], LaneScenes]


@dataclass(frozen=True)
class Size:
    """How a classifier is built and taught."""

    updates: int
    hidden: int = 32
    over_time: bool = True
    """Whether it reads the whole series; else each step by itself."""


def pair_series(scenes: LaneScenes) -> Float[Tensor, "S E C T"]:
    """What a classifier sees of every ordered pair over time; lateral positions in lane widths, all about one."""
    x, y, v, heading = (scenes.state[..., d] for d in range(4))
    y = y / scenes.lane_width[:, None, None]
    a = torch.zeros_like(v)
    a[..., 1:] = (v[..., 1:] - v[..., :-1]) / scenes.dt
    found = []
    for i, j in pairs(x.shape[1]):
        ahead = x[:, i] - x[:, j]
        front = torch.where(ahead > 0, i, j)
        length = scenes.length.gather(1, front)
        gap = ahead.sign() * (ahead.abs() - length).clamp(min=0)
        channels = [
            (gap / 50).clamp(-4, 4),
            (gap / (v[:, j] + 3)).clamp(-20, 20) / 5,
            (v[:, i] - v[:, j]) / 3,
            v[:, j] / 20,
            a[:, i],
            a[:, j],
            10 * ahead.sign() / gap.abs().clamp(min=1),
            y[:, i],
            y[:, j],
            10 * heading[:, i],
            10 * heading[:, j],
        ]
        found.append(torch.stack(channels, 1))
    return torch.stack(found, 1).float()


class StepClassifier(nn.Module):
    """A series network for each ordered pair; each answer also reads the reverse pair and the receiver's other pairs.

    It takes any number of vehicles.
    """

    def __init__(self, size: Size) -> None:
        super().__init__()
        hidden, layers = size.hidden, []
        self.over_time = size.over_time
        for index, dilation in enumerate(DILATIONS):
            kernel, padding = (5, 2 * dilation) if size.over_time else (1, 0)
            inputs = CHANNELS if index == 0 else hidden
            layers += [nn.Conv1d(inputs, hidden, kernel, padding=padding, dilation=dilation), nn.SiLU()]
        self.series = nn.Sequential(*layers)
        inputs = (4 if size.over_time else 3) * hidden
        self.answer = nn.Sequential(nn.Conv1d(inputs, hidden, 1), nn.SiLU(), nn.Conv1d(hidden, len(LANE_CHANGING), 1))

    def forward(self, series: Float[Tensor, "B E C T"], n: int) -> Float[Tensor, "B T E K"]:
        """Logits of the types of all ordered pairs of n vehicles at every step."""
        scenes, edges = series.shape[:2]
        hidden = self.series(series.flatten(0, 1)).unflatten(0, (scenes, edges))
        order = pairs(n)
        reverse = hidden[:, [order.index((j, i)) for i, j in order]]
        same = torch.tensor([[float(a != b and a[1] == b[1]) for b in order] for a in order])
        same = same / same.sum(1, keepdim=True).clamp(min=1)
        others = torch.einsum("ef,sfht->seht", same, hidden)
        parts = [hidden, reverse, others]
        if self.over_time:
            parts.append(hidden.mean(-1, keepdim=True).expand_as(hidden))
        answer = self.answer(torch.cat(parts, 2).flatten(0, 1)).unflatten(0, (scenes, edges))
        return answer.permute(0, 3, 1, 2)


def train_step_classifier(
    scenes: Sequence[LaneScenes], see: See, seed: int, size: Size
) -> Callable[[LaneScenes], Float[Tensor, "S T E K"]]:
    """Teach a classifier the relations of every scored step; `see` hides from scenes what it may not see.

    In a third of the updates one vehicle is not in the scene, so that it also learns scenes with two.
    """
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    every = joined(scenes)
    variants = [every, *(every.without(role) for role in every.roles[1:])]
    sets = [_prepared(variant, see, 0 if size.over_time else FIRST) for variant in variants]
    model = StepClassifier(size)
    optimiser = torch.optim.Adam(model.parameters(), 4e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 4e-3, total_steps=size.updates)
    for update in range(size.updates):
        which = 0 if update % 3 else 1 + update // 3 % (len(sets) - 1)
        series, truth, scored = sets[which]
        rows = torch.randint(len(series), (BATCH,), generator=generator)
        logits = model(series[rows], len(variants[which].roles))
        loss = nn.functional.cross_entropy(logits[scored[rows]], truth[rows][scored[rows]])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    model.eval()

    @torch.no_grad()
    def infer(known: LaneScenes) -> Float[Tensor, "S T E K"]:
        return model(pair_series(see(known)), len(known.roles)).softmax(-1).double()

    return infer


def _prepared(scenes: LaneScenes, see: See, start: int) -> tuple[Tensor, Tensor, Bool[Tensor, "S T E"]]:
    """Series, types and what is scored, from the step `start` on."""
    scored = balanced_steps(scenes.relations, pairs_that_may_react(scenes.roles), FIRST, MOST, seed=0)
    return pair_series(see(scenes))[..., start:], scenes.relations[:, start:], scored[:, start:]


def first_frame(scenes: LaneScenes) -> LaneScenes:
    """Scenes that stay as they begin: a check that starts say nothing about relations."""
    return replace(scenes, state=scenes.state[:, :, :1].expand_as(scenes.state))
