"""A state predictor: from late states to what they are probably now, for a policy that knows how late they are."""

from dataclasses import dataclass, field
from itertools import pairwise

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gri.core.dynamics import Dynamics


@dataclass(frozen=True)
class StatePredictor:
    """Predicts late states over a known delay by the dynamics.

    Others are seen `others` steps of `dt` [s] late: they keep their last seen acceleration and yaw rate. In its own
    view (`own[view, role]`) a driven vehicle knows its place `self_` steps late, but has felt its accelerations and yaw
    rates since: dead reckoning from the last known place. Nobody drives backwards.
    """

    dynamics: Dynamics
    dt: float
    others: int
    self_: int
    own: Bool[Tensor, "E N"]
    felt: list[Float[Tensor, "E G N F"]] = field(default_factory=list)

    def predicted(self, shown: Float[Tensor, "E G N D"], *, final: bool = True) -> Float[Tensor, "E G N D"]:
        """The present states of what a view shows; with `final=False` this step is asked about once more later.

        A vehicle's own acceleration and yaw rate in `shown` are those of the present.
        """
        feels = [k for k, name in enumerate(self.dynamics.state) if name in ("a", "yaw_rate")]
        felt = [*self.felt[-self.self_ :], shown[..., feels]] if self.self_ else []
        if final and self.self_:
            self.felt.append(shown[..., feels])
        ahead = shown
        for _ in range(self.others):
            ahead = self._step(ahead, torch.zeros_like(ahead[..., : len(self.dynamics.action)]))
        itself = shown
        if self.self_:
            felt = [felt[0]] * (self.self_ + 1 - len(felt)) + felt
            itself = shown.clone()
            itself[..., feels] = felt[0]
            for before, now in pairwise(felt):
                itself = self._step(itself, (now - before) / self.dt)
            itself[..., feels] = felt[-1]
        return torch.where(self.own[:, None, :, None], itself, ahead)

    def _step(self, state: Float[Tensor, "*batch D"], action: Float[Tensor, "*batch A"]) -> Float[Tensor, "*batch D"]:
        following = self.dynamics.step(state, action, self.dt)
        return following if self.dynamics.stop is None else self.dynamics.stop(state, following)
