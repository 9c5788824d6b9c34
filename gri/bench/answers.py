"""What a row of the benchmark answers: the probability of each relation, and how little it trusts itself."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from gri.bench.car_following_scenes import KnownScenes
from gri.core.edges import pairs
from gri.errors import InputError


@dataclass(frozen=True)
class Answer:
    """An answer for every ordered pair (sender, receiver), in the order of `gri.pairs`."""

    follow: Float[Tensor, "S E"]
    """P(the receiver follows the sender)."""
    unknown: Float[Tensor, "S E"] | None = None
    """How strange the scene is to the row; only the order of the values counts. None: 1 − the largest probability."""

    @property
    def uncertainty(self) -> Float[Tensor, "S E"]:
        """`unknown`, or 1 − the probability of the answer that is given."""
        return 1 - torch.maximum(self.follow, 1 - self.follow) if self.unknown is None else self.unknown


Score = Callable[[KnownScenes], Float[Tensor, "S E"]]
"""Scenes → a number per pair that grows with the evidence for a relation."""
Infer = Callable[[KnownScenes], Answer | Float[Tensor, "S E"]]
"""Scenes → an answer, or only P(follow)."""


def observed(scenes: KnownScenes) -> Float[Tensor, "S N T 3"]:
    """What rows may see of scenes: their first `shown` states."""
    return scenes.state[:, :, : scenes.shown]


def ask(infer: Infer, scenes: KnownScenes) -> Answer:
    """The answer of a row to scenes.

    Raises:
        InputError: scenes with states that are not finite, or shorter than `shown`. No row may answer "none" there.
        ValueError: an answer that is not finite, or probabilities below 0 or above 1.
    """
    if scenes.state.shape[2] < scenes.shown:
        got = scenes.state.shape[2]
        raise InputError(f"got scenes of {got} states, wanted {scenes.shown} or more; give longer ones")
    if missing := int((~torch.isfinite(observed(scenes))).any(-1).any(-1).any(-1).sum()):
        raise InputError(f"got {missing} scenes with states that are not finite; leave them out")
    given = infer(scenes)
    answer = given if isinstance(given, Answer) else Answer(given)
    wanted = len(scenes), len(pairs(scenes.state.shape[1]))
    for name, value in (("follow", answer.follow), ("unknown", answer.uncertainty)):
        if tuple(value.shape) != wanted or not bool(torch.isfinite(value).all()):
            raise ValueError(f"got an answer with {name} {tuple(value.shape)}, wanted {wanted} finite numbers")
    if bool(((answer.follow < 0) | (answer.follow > 1)).any()):
        raise ValueError(f"got P(follow) from {answer.follow.min()} to {answer.follow.max()}, wanted 0 to 1")
    return answer
