"""What all objectives share: batches, losses and the optimiser."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Literal

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.core.dynamics import Dynamics, DynamicsName


def batches(
    scenes: int, size: int, updates: int, generator: torch.Generator, weight: Float[Tensor, " S"] | None = None
) -> Iterator[Tensor]:
    """Indices of one random batch per update; scenes are drawn as often as they weigh."""
    size = min(size, scenes)
    for _ in range(updates):
        if weight is None:
            yield torch.randint(0, scenes, (size,), generator=generator)
        else:
            yield torch.multinomial(weight, size, replacement=True, generator=generator)


def reconstruction_loss(
    state: Float[Tensor, "B N T D"], recorded: Float[Tensor, "B N T D"], dynamics: Dynamics
) -> Float[Tensor, ""]:
    """Mean squared error of positions and speeds over driven vehicles and time, as the tables report it (SI units)."""
    return squared_error(state, recorded, dynamics).mean()


def squared_error(
    state: Float[Tensor, "B N T D"], recorded: Float[Tensor, "B N T D"], dynamics: Dynamics
) -> Float[Tensor, "B R T"]:
    """Squared error of position and speed of every driven vehicle at every instant; of 2-D point masses, errors across
    the road count `ACROSS` times.
    """
    counted = [dynamics.index(name) for name in ("x", "y", "v", "vx", "vy") if name in dynamics.state]
    error = (state - recorded)[:, :-1, :, counted]
    if dynamics.name is DynamicsName.POINT_MASS_2D:
        error = error * error.new_tensor([ACROSS if dynamics.state[d] in ("y", "vy") else 1.0 for d in counted])
    return (error**2).sum(-1)


ACROSS = 5.0
"""A lane is 3.7 m wide, whereas people differ by 15 m and more in how far they keep behind: with equal weights nothing
would be learned of where in their lane they drive.
"""


def action_error(
    action: Float[Tensor, "B R T A"], recorded: Float[Tensor, "B R T A"], unit: Float[Tensor, " A"]
) -> Float[Tensor, ""]:
    """Mean squared error of actions in their units: positions alone hardly tell a smooth drive from a jittery one."""
    return (((action - recorded) / unit) ** 2).mean()


def categorical_kl(logits: Float[Tensor, "B E K"], prior: Float[Tensor, " K"]) -> Float[Tensor, "B E"]:
    """KL[q(z_ij|τ) || p(z_ij)] of each edge, in nats."""
    log_q = logits.log_softmax(-1)
    return (log_q.exp() * (log_q - prior.log())).sum(-1)


class Bottleneck(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The constraint E KL[q(z|τ) || p(z)] ≤ I_c and how its multiplier β is found (docs/decisions/005-beta.md)."""

    form: Literal["printed", "accumulating"] = "printed"
    """β ← max(0, α·(KL − I_c)) as printed in Sec. V-B, or β ← max(0, β + α·(KL − I_c)), dual ascent."""
    rate: float = 1.0
    """α_β."""
    information: float = 0.0
    """I_c, mean per edge [nats]."""
    no_edge_prior: float = 0.9
    """p(z_ij = 0); the other types share the rest."""


def updated_beta(beta: float, kl: float, bottleneck: Bottleneck) -> float:
    """β after one more step."""
    before = beta if bottleneck.form == "accumulating" else 0.0
    return max(0.0, before + bottleneck.rate * (kl - bottleneck.information))


LEFT_OUT = 20
"""Updates in a row that may be left out."""


class Descent:
    """Adam with a cosine schedule to 2 % of the rate and clipped gradients; `step(loss)` does one update.

    Parameters that need no gradient are left as they are.
    """

    def __init__(
        self, parameters: Iterable[nn.Parameter], rate: float, updates: int, clip: float = 10.0, beta: float = 0.9
    ) -> None:
        self.parameters, self.clip = [p for p in parameters if p.requires_grad], clip
        self.optimiser = torch.optim.Adam(self.parameters, rate, (beta, 0.99))
        self.schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self.optimiser, updates, eta_min=0.02 * rate)
        self._left_out = 0  # updates in a row

    def step(self, loss: Tensor) -> None:
        """Descend the loss; gradients that reach other parameters are not kept."""
        self.apply(self.gradients(loss))

    def gradients(self, loss: Tensor, retain_graph: bool = False) -> Sequence[Tensor | None]:
        """The loss's gradients, for a step taken later: where two descents share one loss."""
        return torch.autograd.grad(loss, self.parameters, allow_unused=True, retain_graph=retain_graph)

    def apply(self, gradients: Sequence[Tensor | None]) -> None:
        """Clip the gradients and do one update; none where a roll-out ran away and they are not finite.

        Errors: `FloatingPointError` where that goes on.
        """
        for parameter, gradient in zip(self.parameters, gradients, strict=True):
            parameter.grad = gradient
        norm = nn.utils.clip_grad_norm_(self.parameters, self.clip)
        self._left_out = 0 if bool(norm.isfinite()) else self._left_out + 1
        if self._left_out > LEFT_OUT:
            raise FloatingPointError(f"{LEFT_OUT} updates in a row had no finite gradient; lower the rates")
        if not self._left_out:
            self.optimiser.step()
            self.schedule.step()
