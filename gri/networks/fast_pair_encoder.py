"""The pair encoder on a list of candidate pairs: the values of `gri.networks.pair_encoder` for any number of vehicles.

`PairEncoder.forward` judges all ordered pairs of a few vehicles. Here the pairs are given
(`gri.core.candidate_pairs`), so that the cost grows with the pairs. Where they are all ordered pairs of a scene, the
values are the same up to rounding: `test_complete_graph_is_one_case` in tests/gri/networks/test_fast_pair_encoder.py.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn.functional import pad

from gri.networks.fast_reaction_evidence import reaction_evidence
from gri.networks.pair_encoder import PairEncoder, PairMotion, Pairs, pair_motion

AT_ONCE = 512  # pairs that are embedded together, so that they stay in the cache


@torch.no_grad()
def explain_pairs(
    encoder: PairEncoder, x: Float[Tensor, "V T"], v: Float[Tensor, "V T"], pairs: Int[Tensor, "E 2"]
) -> tuple[Float[Tensor, "V 2"], Float[Tensor, " E"]]:
    """Probabilities of the explanations of each vehicle's motion, given the vehicles that it may react to.

    Args:
        encoder: a trained pair encoder.
        x: positions [m]; v: speeds [m/s]; T instants, `encoder.dt` apart.
        pairs: candidate pairs (sender, receiver), each once.

    Returns:
        own speed and unseen leader, for each vehicle; and "the receiver reacts to the sender", for each pair. It is 0
        for senders that are not ahead at the last instant. They add up to 1 for each vehicle.
    """
    dtype = next(encoder.parameters()).dtype
    ahead = x[pairs[:, 0], -1] > x[pairs[:, 1], -1]
    sender, receiver = pairs[ahead].unbind(1)
    which = Pairs(torch.zeros_like(sender), receiver, sender)
    motion = PairMotion(*(series.to(dtype) for series in pair_motion(x[None], v[None], which, encoder.dt)))
    found = [_shares(member, motion, receiver, len(x)) for member in encoder.members]
    if len(found) == 1:
        nulls, score = found[0]
    else:  # the mean of the members' log probabilities
        logs = [torch.stack(part).clamp(min=1e-30).log().mean(0) for part in zip(*found, strict=True)]
        nulls, score = (part.exp() for part in logs)
        total = nulls.sum(1).index_add(0, receiver, score)
        nulls, score = nulls / total[:, None], score / total[receiver]
    return nulls, score.new_zeros(len(pairs)).masked_scatter(ahead, score)


def _shares(
    encoder: PairEncoder, motion: PairMotion, receiver: Int[Tensor, " E"], vehicles: int
) -> tuple[Float[Tensor, "V 2"], Float[Tensor, " E"]]:
    """Probabilities of both nulls of each vehicle, and of each pair with the sender ahead, by one network alone."""
    dtype, width = motion.gap.dtype, encoder.config.hidden
    parts = zip(*(series.split(AT_ONCE) for series in motion), strict=True)
    embedded = torch.cat(
        [_embed(encoder, PairMotion(*part)) for part in parts if len(part[0])] or [torch.zeros(0, width, dtype=dtype)]
    )
    context = _context(embedded, receiver, vehicles)
    score = encoder.follow(torch.cat([embedded, context[receiver]], -1))[:, 0]
    nulls = encoder.nulls(context)
    greatest = nulls.amax(1).scatter_reduce(0, receiver, score, "amax")
    nulls, score = (nulls - greatest[:, None]).exp(), (score - greatest[receiver]).exp()
    total = nulls.sum(1).index_add(0, receiver, score)
    return nulls / total[:, None], score / total[receiver]


def _embed(encoder: PairEncoder, motion: PairMotion) -> Float[Tensor, "P H"]:
    """As `PairEncoder`; the first convolution, with its odd number of channels, is one matrix product."""
    first, *others = encoder.convolutions
    assert isinstance(first, nn.Conv1d)
    features = nn.Sequential(*others)(_as_product(first, encoder.series(motion)))
    return encoder.embedded(features, motion, reaction_evidence)


def _as_product(layer: nn.Conv1d, series: Float[Tensor, "P C T"]) -> Float[Tensor, "P H T"]:
    """A convolution as a product of all its windows with its weights."""
    width = layer.kernel_size[0]
    windows = pad(series, (width // 2, width // 2)).mT.contiguous()  # Shape: (P, T + width - 1, C)
    p, steps, channels = windows.shape
    shape, strides = (p, steps - width + 1, width * channels), (steps * channels, channels, 1)
    weight = layer.weight.permute(2, 1, 0).flatten(0, 1)  # Shape: (width * C, H)
    product = windows.as_strided(shape, strides).flatten(0, 1) @ weight
    return product.unflatten(0, shape[:2]).mT + (0.0 if layer.bias is None else layer.bias[:, None])


def _context(embedded: Float[Tensor, "P H"], receiver: Int[Tensor, " P"], vehicles: int) -> Float[Tensor, "V 2*H"]:
    """Mean and maximum over each vehicle's senders ahead; zero where there is none."""
    width = embedded.shape[1]
    count = torch.bincount(receiver, minlength=vehicles)[:, None]
    mean = embedded.new_zeros(vehicles, width).index_add(0, receiver, embedded) / count.clamp(min=1)
    index = receiver[:, None].expand(-1, width)
    largest = embedded.new_full((vehicles, width), -torch.inf).scatter_reduce(0, index, embedded, "amax")
    return torch.cat([mean, largest.masked_fill(count == 0, 0.0)], -1)
