"""Building blocks that the networks share: fully connected layers, and the ends of edges as indices."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from gri.core.array_functions import cache_tensors
from gri.core.graph import pairs


def mlp(sizes: Sequence[int], last_scale: float = 1.0) -> nn.Sequential:
    """Fully connected layers with SiLU between them. Initial weights of the last layer are scaled by `last_scale`."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.SiLU()]
    last = layers[-2]
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        last.weight.mul_(last_scale)
        last.bias.mul_(last_scale)
    return nn.Sequential(*layers[:-1])


@cache_tensors
def edge_ends(n: int) -> tuple[Tensor, Tensor]:
    """Senders [E] and receivers [E] of the ordered pairs of n vehicles, in the order of the edge axis."""
    senders, receivers = zip(*pairs(n), strict=True)
    return torch.tensor(senders), torch.tensor(receivers)


@cache_tensors
def incidence(n: int) -> Tensor:
    """Matrix [N, E] that sums values over the edges that enter each vehicle."""
    return nn.functional.one_hot(edge_ends(n)[1], n).T.float()
