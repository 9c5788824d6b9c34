"""What grounded training varies: graphs and starts, so that edges keep their meaning off the data, and what is seen."""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.dynamics import POINT_MASS_1D, Dynamics
from gri.core.graph import pairs
from gri.core.layers import edge_ends
from gri.core.scenes import Scenes


class Augmentation(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is done to histories before the encoder learns from them; the labels stay."""

    position_noise: float = 0.0  # [m]
    speed_noise: float = 0.0  # [m/s]
    stretch: tuple[float, float] = (1.0, 1.0)
    """Range of factors on each headway's mean over the history: people keep unlike distances."""
    faster: float = 0.0
    """By how much at most all vehicles are shown faster [m/s], and headways longer by the way of `HEADWAY` seconds.

    How quickly traffic flows says nothing of who heeds whom, and recorded traffic is mostly slow.
    """
    window: bool = False
    """Show the encoder `history_steps` successive states from anywhere in the scene instead of all of them.
    """


HEADWAY = 1.3
"""Added time headway of faster traffic: the mean of IDM drivers on US-101 [s]."""


class Shifts(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How starts are shifted, half of them, before the policy maximises the reward from there; uniform ranges."""

    position: tuple[float, float] = (0.0, 12.0)  # [m]
    lateral: tuple[float, float] = (0.0, 0.0)  # [m]
    speed: tuple[float, float] = (0.0, 0.0)  # [m/s]
    acceleration: tuple[float, float] = (0.0, 0.0)  # [m/s^2]


def elsewhere(
    scenes: Scenes,
    shifts: Shifts,
    least_headway: float | None,
    dynamics: Dynamics,
    types: int,
    count: int,
    generator: torch.Generator,
) -> tuple[Float[Tensor, "B N D"], Float[Tensor, "B T D"], Float[Tensor, "B E K"]]:
    """Starts of random scenes, half of them shifted, their leader's states, and random graphs, which have no edge over
    less than the least headway [m] if there is one.
    """
    batch = scenes[torch.randint(0, len(scenes), (count,), generator=generator)]
    start = shift(batch.start, shifts, generator, dynamics)
    graph = random_graphs(count, start.shape[1], types, generator)
    if least_headway is not None:
        graph = hold_out(graph, start, least_headway)
    return start, batch.leader, graph


def random_graphs(count: int, vehicles: int, types: int, generator: torch.Generator) -> Float[Tensor, "B E K"]:
    """Every edge is "none" with probability ½, else of any other type, as one-hot vectors."""
    drawn = torch.randint(0, 2 * (types - 1), (count, len(pairs(vehicles))), generator=generator)
    drawn = (drawn - (types - 2)).clamp(min=0)
    return torch.nn.functional.one_hot(drawn, types).float()


def hold_out(graph: Float[Tensor, "B E K"], start: Float[Tensor, "B N D"], headway: float) -> Float[Tensor, "B E K"]:
    """The graphs without the edges whose sender starts less than the headway ahead of the receiver."""
    senders, receivers = edge_ends(start.shape[1])
    near = start[:, senders, 0] - start[:, receivers, 0] < headway
    none = torch.eye(graph.shape[-1])[0].expand_as(graph)
    return torch.where(near[..., None], none, graph)


def shift(
    start: Float[Tensor, "B N D"],
    shifts: Shifts,
    generator: torch.Generator,
    dynamics: Dynamics = POINT_MASS_1D,
) -> Float[Tensor, "B N D"]:
    """Half of the starts with every driven vehicle moved by its own amount; speeds stay at or above zero."""
    by_feature = {"x": shifts.position, "y": shifts.lateral, "v": shifts.speed, "a": shifts.acceleration}
    by_feature |= {"vx": shifts.speed, "ax": shifts.acceleration}
    ranges = torch.tensor([by_feature.get(feature, (0.0, 0.0)) for feature in dynamics.state])
    amount = torch.rand(start.shape, generator=generator) * (ranges[:, 1] - ranges[:, 0]) + ranges[:, 0]
    amount[:, -1] = 0
    amount[len(amount) // 2 :] = 0
    speed = dynamics.speed
    moved = start + amount
    return torch.cat([moved[..., :speed], moved[..., speed : speed + 1].clamp(min=0), moved[..., speed + 1 :]], -1)


def augment(
    state: Float[Tensor, "B N T D"],
    augmentation: Augmentation,
    history_steps: int,
    generator: torch.Generator,
    dynamics: Dynamics = POINT_MASS_1D,
    dt: float = 0.2,
) -> Float[Tensor, "B N S D"]:
    """Histories for the encoder: a window of the scene, noise, headways stretched about their mean, faster traffic."""
    if augmentation.window:
        first = int(torch.randint(0, state.shape[2] - history_steps + 1, (1,), generator=generator))
        state = state[:, :, first : first + history_steps]
    v = dynamics.speed
    position, speed = state[..., 0], state[..., v]
    row = position.mean(-1).argsort(-1)  # Shape: (B, N), from back to front
    place = row.argsort(-1)  # of each vehicle in that row
    headway = position.take_along_dim(row[..., None], 1).diff(dim=1).mean(-1)
    low, high = augmentation.stretch
    factor = low + (high - low) * torch.rand(headway.shape, generator=generator)
    back = ((factor - 1) * headway).flip(1).cumsum(1).flip(1)  # how far each vehicle but the first falls back
    back = torch.nn.functional.pad(back, (0, 1)).gather(1, place)
    position = position - back[..., None]
    position = position + augmentation.position_noise * torch.randn(position.shape, generator=generator)
    speed = speed + augmentation.speed_noise * torch.randn(speed.shape, generator=generator)
    if augmentation.faster:
        added = augmentation.faster * torch.rand(len(state), 1, 1, generator=generator)
        ahead = state.shape[1] - 1 - place
        time = dt * torch.arange(state.shape[2])
        position, speed = position + added * (time - HEADWAY * ahead[..., None]), speed + added
    return torch.cat([position[..., None], state[..., 1:v], speed[..., None], state[..., v + 1 :]], -1)
