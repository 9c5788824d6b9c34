"""Random graphs, shifted starts and augmented histories for grounded training.

With random graphs and shifted starts, edges keep their meaning off the data. Augmented histories make the encoder
robust.
"""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.dynamics import POINT_MASS_1D, Dynamics
from gri.core.graph import pairs
from gri.core.layers import edge_ends
from gri.core.scenes import Scenes


class Augmentation(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Augmentation of the histories from which the encoder learns. The graphs stay the same."""

    position_noise: float = 0.0
    """Standard deviation of noise on x [m]."""
    speed_noise: float = 0.0
    """Standard deviation of noise on the speed [m/s]."""
    stretch: tuple[float, float] = (1.0, 1.0)
    """Range of a random factor on each mean headway of the history, as drivers keep different headways."""
    faster: float = 0.0
    """Largest speed that is added to all vehicles [m/s]. Headways grow by the added speed × `ADDED_TIME_HEADWAY`.

    Recorded traffic is mostly slow, but the speed of traffic does not determine who reacts to whom.
    """
    window: bool = False
    """Use a random window of `history_steps` states of the scene, instead of all states."""


ADDED_TIME_HEADWAY = 1.3
"""Time headway of the added speed: the mean of IDM drivers on US-101 [s]."""


class Shifts(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Ranges of uniform random shifts. Half of the starts from which the policy maximises the reward are shifted."""

    position: tuple[float, float] = (0.0, 12.0)  # [m]
    lateral: tuple[float, float] = (0.0, 0.0)  # [m]
    speed: tuple[float, float] = (0.0, 0.0)  # [m/s]
    acceleration: tuple[float, float] = (0.0, 0.0)  # [m/s^2]


def sample_off_data(
    scenes: Scenes,
    shifts: Shifts,
    min_headway: float | None,
    dynamics: Dynamics,
    types: int,
    count: int,
    generator: torch.Generator,
) -> tuple[Float[Tensor, "B N D"], Float[Tensor, "B T D"], Float[Tensor, "B E K"]]:
    """B = `count` starts of random scenes, the leader's states, and random one-hot graphs with K = `types`.

    Half of the starts are shifted. If `min_headway` [m] is given, the graphs have no edge over a shorter headway.
    """
    batch = scenes[torch.randint(0, len(scenes), (count,), generator=generator)]
    start = shift_starts(batch.start, shifts, generator, dynamics)
    graph = random_graphs(count, start.shape[1], types, generator)
    if min_headway is not None:
        graph = without_short_headway_edges(graph, start, min_headway)
    return start, batch.leader, graph


def random_graphs(count: int, vehicles: int, types: int, generator: torch.Generator) -> Float[Tensor, "B E K"]:
    """One-hot random graphs: each edge is "none" with probability ½, else one of the other types with equal shares."""
    drawn = torch.randint(0, 2 * (types - 1), (count, len(pairs(vehicles))), generator=generator)
    drawn = (drawn - (types - 2)).clamp(min=0)
    return torch.nn.functional.one_hot(drawn, types).float()


def without_short_headway_edges(
    graph: Float[Tensor, "B E K"], start: Float[Tensor, "B N D"], headway: float
) -> Float[Tensor, "B E K"]:
    """The graphs without the edges whose sender starts less than `headway` [m] ahead of the receiver."""
    senders, receivers = edge_ends(start.shape[1])
    near = start[:, senders, 0] - start[:, receivers, 0] < headway
    none = torch.eye(graph.shape[-1])[0].expand_as(graph)
    return torch.where(near[..., None], none, graph)


def shift_starts(
    start: Float[Tensor, "B N D"],
    shifts: Shifts,
    generator: torch.Generator,
    dynamics: Dynamics = POINT_MASS_1D,
) -> Float[Tensor, "B N D"]:
    """The starts, of which the first half has an independent random shift for each driven vehicle.

    Speeds stay at or above 0. The leader (the last vehicle) is not shifted.
    """
    by_feature = {"x": shifts.position, "y": shifts.lateral, "v": shifts.speed, "a": shifts.acceleration}
    by_feature |= {"vx": shifts.speed, "ax": shifts.acceleration}
    ranges = torch.tensor([by_feature.get(feature, (0.0, 0.0)) for feature in dynamics.state])
    amount = torch.rand(start.shape, generator=generator) * (ranges[:, 1] - ranges[:, 0]) + ranges[:, 0]
    amount[:, -1] = 0
    amount[len(amount) // 2 :] = 0
    speed = dynamics.speed
    moved = start + amount
    return torch.cat([moved[..., :speed], moved[..., speed : speed + 1].clamp(min=0), moved[..., speed + 1 :]], -1)


def augment_histories(
    state: Float[Tensor, "B N T D"],
    augmentation: Augmentation,
    history_steps: int,
    generator: torch.Generator,
    dynamics: Dynamics = POINT_MASS_1D,
    dt: float = 0.2,
) -> Float[Tensor, "B N S D"]:
    """Augmented histories for the encoder: a random window, stretched headways, noise, added speed.

    `state` is in the layout of `dynamics`, `dt` the time step [s]. S is `history_steps` with a window, else T.
    """
    if augmentation.window:
        first = int(torch.randint(0, state.shape[2] - history_steps + 1, (1,), generator=generator))
        state = state[:, :, first : first + history_steps]
    v = dynamics.speed
    position, speed = state[..., 0], state[..., v]
    order = position.mean(-1).argsort(-1)  # Shape: (B, N), from rear to front
    rank = order.argsort(-1)
    headway = position.take_along_dim(order[..., None], 1).diff(dim=1).mean(-1)
    low, high = augmentation.stretch
    factor = low + (high - low) * torch.rand(headway.shape, generator=generator)
    back = ((factor - 1) * headway).flip(1).cumsum(1).flip(1)  # Shape: (B, N−1), shift of each vehicle except the first
    back = torch.nn.functional.pad(back, (0, 1)).gather(1, rank)
    position = position - back[..., None]
    position = position + augmentation.position_noise * torch.randn(position.shape, generator=generator)
    speed = speed + augmentation.speed_noise * torch.randn(speed.shape, generator=generator)
    if augmentation.faster:
        added = augmentation.faster * torch.rand(len(state), 1, 1, generator=generator)
        ahead = state.shape[1] - 1 - rank
        time = dt * torch.arange(state.shape[2])
        position, speed = position + added * (time - ADDED_TIME_HEADWAY * ahead[..., None]), speed + added
    return torch.cat([position[..., None], state[..., 1:v], speed[..., None], state[..., v + 1 :]], -1)
