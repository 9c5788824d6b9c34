"""What all objectives share: batches, losses and the optimiser."""

from collections.abc import Iterable, Iterator

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.dynamics import Dynamics


def batches(scenes: int, size: int, updates: int, generator: torch.Generator) -> Iterator[Tensor]:
    """Indices of one random batch per update."""
    for _ in range(updates):
        yield torch.randint(0, scenes, (min(size, scenes),), generator=generator)


def reconstruction_loss(
    state: Float[Tensor, "B N T D"], recorded: Float[Tensor, "B N T D"], dynamics: Dynamics
) -> Float[Tensor, ""]:
    """Mean squared error of positions and speeds over driven vehicles and time, as the tables report it (SI
    units).
    """
    counted = [dynamics.index(name) for name in ("x", "y", "v", "vx", "vy") if name in dynamics.state]
    return ((state - recorded)[:, :-1, :, counted] ** 2).sum(-1).mean()


def categorical_kl(logits: Float[Tensor, "B E K"], prior: Float[Tensor, " K"]) -> Float[Tensor, "B E"]:
    """KL[q(z_ij|τ) || p(z_ij)] of each edge, in nats."""
    log_q = logits.log_softmax(-1)
    return (log_q.exp() * (log_q - prior.log())).sum(-1)


class Descent:
    """Adam with a cosine schedule to 2 % of the rate and clipped gradients; `step(loss)` does one update."""

    def __init__(
        self, parameters: Iterable[nn.Parameter], rate: float, updates: int, clip: float = 10.0, beta: float = 0.9
    ) -> None:
        self.parameters, self.clip = list(parameters), clip
        self.optimiser = torch.optim.Adam(self.parameters, rate, (beta, 0.99))
        self.schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self.optimiser, updates, eta_min=0.02 * rate)

    def step(self, loss: Tensor) -> None:
        """Descend the loss; gradients that reach other parameters are not kept."""
        gradients = torch.autograd.grad(loss, self.parameters, allow_unused=True)
        for parameter, gradient in zip(self.parameters, gradients, strict=True):
            parameter.grad = gradient
        nn.utils.clip_grad_norm_(self.parameters, self.clip)
        self.optimiser.step()
        self.schedule.step()
