"""Batches, losses and the optimiser, which all objectives share."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.core.dynamics import Dynamics, DynamicsName


def batches(
    scenes: int, size: int, updates: int, generator: torch.Generator, weight: Float[Tensor, " S"] | None = None
) -> Iterator[Tensor]:
    """For each of `updates`: the indices of a random batch of up to `size` scenes, sampled with replacement.

    `weight` gives relative probabilities; None: all scenes are equally probable.
    """
    for _ in range(updates):
        yield draw_batch(scenes, size, generator, weight)


def draw_batch(scenes: int, size: int, generator: torch.Generator, weight: Float[Tensor, " S"] | None = None) -> Tensor:
    """The indices of one batch, as `batches` draws them."""
    size = min(size, scenes)
    if weight is None:
        return torch.randint(0, scenes, (size,), generator=generator)
    return torch.multinomial(weight, size, replacement=True, generator=generator)


def reconstruction_loss(
    state: Float[Tensor, "B N T D"], recorded: Float[Tensor, "B N T D"], dynamics: Dynamics
) -> Float[Tensor, ""]:
    """Mean squared error of positions [m] and speeds [m/s] over the driven vehicles and time (Sec. VI-B)."""
    return squared_error(state, recorded, dynamics).mean()


def squared_error(
    state: Float[Tensor, "B N T D"], recorded: Float[Tensor, "B N T D"], dynamics: Dynamics
) -> Float[Tensor, "B R T"]:
    """Squared error of position and speed for each driven vehicle (R = N − 1) and step, in SI units.

    For 2-D point masses, lateral errors are multiplied by `LATERAL_WEIGHT` before they are squared.
    """
    counted = [dynamics.index(name) for name in ("x", "y", "v", "vx", "vy") if name in dynamics.state]
    error = (state - recorded)[:, :-1, :, counted]
    if dynamics.name is DynamicsName.POINT_MASS_2D:
        error = error * error.new_tensor([LATERAL_WEIGHT if dynamics.state[d] in ("y", "vy") else 1.0 for d in counted])
    return (error**2).sum(-1)


LATERAL_WEIGHT = 5.0
"""Weight of lateral errors. Headways of drivers differ by 15 m and more, but a lane is only 3.7 m wide. With equal
weights, a model would not learn the lateral position in the lane.
"""


def action_error(
    action: Float[Tensor, "B R T A"], recorded: Float[Tensor, "B R T A"], unit: Float[Tensor, " A"]
) -> Float[Tensor, ""]:
    """Mean squared error of actions in units of `unit`. Positions alone hardly penalise jittery actions."""
    return (((action - recorded) / unit) ** 2).mean()


def categorical_kl(
    logits: Float[Tensor, "B E K"], prior: Float[Tensor, " K"] | Float[Tensor, "B E K"]
) -> Float[Tensor, "B E"]:
    """KL[q(z_ij|τ) || p(z_ij)] of each edge [nats]; the prior may differ between scenes and edges."""
    log_q = logits.log_softmax(-1)
    return (log_q.exp() * (log_q - prior.log())).sum(-1)


class Bottleneck(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The constraint E KL[q(z|τ) || p(z)] ≤ I_c, and the update of its multiplier β (docs/decisions/005-beta.md)."""

    form: Literal["printed", "accumulating"] = "printed"
    """`printed`: β ← max(0, α·(KL − I_c)) (Sec. V-B). `accumulating`: β ← max(0, β + α·(KL − I_c)), dual ascent."""
    rate: float = 1.0
    """Step size α_β."""
    information: float = 0.0
    """I_c, mean per edge [nats]."""
    no_edge_prior: float = 0.9
    """p(z_ij = 0). The other types have equal shares of the rest."""


def updated_beta(beta: float, kl: float, bottleneck: Bottleneck) -> float:
    """β after one update, for the mean KL per edge [nats]."""
    before = beta if bottleneck.form == "accumulating" else 0.0
    return max(0.0, before + bottleneck.rate * (kl - bottleneck.information))


MAX_SKIPPED_UPDATES = 20
"""Successive updates that may be skipped because their gradients are not finite."""


class Descent:
    """Adam with clipped gradients and a cosine schedule down to 2 % of the rate over `updates` updates.

    `step(loss)` does one update. Parameters that do not require a gradient stay unchanged. `clip` bounds the norm of
    the gradient, `beta` is Adam's β₁.
    """

    def __init__(
        self, parameters: Iterable[nn.Parameter], rate: float, updates: int, clip: float = 10.0, beta: float = 0.9
    ) -> None:
        self.parameters, self.clip = [p for p in parameters if p.requires_grad], clip
        self.optimiser = torch.optim.Adam(self.parameters, rate, (beta, 0.99))
        self.schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self.optimiser, updates, eta_min=0.02 * rate)
        self._skipped = 0  # successive updates

    def step(self, loss: Tensor) -> None:
        """One update that reduces the loss. Gradients with respect to other parameters are not computed."""
        self.apply(self.gradients(loss))

    def gradients(self, loss: Tensor, retain_graph: bool = False) -> Sequence[Tensor | None]:
        """The gradients of the loss, for `apply`. Needed when two descents share one loss."""
        return torch.autograd.grad(loss, self.parameters, allow_unused=True, retain_graph=retain_graph)

    def apply(self, gradients: Sequence[Tensor | None]) -> None:
        """Clip the gradients and do one update. Skip it if they are not finite, as after a diverged roll-out.

        Errors: `FloatingPointError` after more than `MAX_SKIPPED_UPDATES` successive skips.
        """
        for parameter, gradient in zip(self.parameters, gradients, strict=True):
            parameter.grad = gradient
        norm = nn.utils.clip_grad_norm_(self.parameters, self.clip)
        self._skipped = 0 if bool(norm.isfinite()) else self._skipped + 1
        if self._skipped > MAX_SKIPPED_UPDATES:
            raise FloatingPointError(
                f"{MAX_SKIPPED_UPDATES} successive updates had no finite gradient; lower the rates"
            )
        if not self._skipped:
            self.optimiser.step()
            self.schedule.step()

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Copies of all that later updates depend on, as tensors and numbers."""
        tensors = {f"parameter.{k}": p.detach().clone().contiguous() for k, p in enumerate(self.parameters)}
        optimiser, schedule = self.optimiser.state_dict(), self.schedule.state_dict()
        for k, of in optimiser["state"].items():
            tensors |= {f"adam.{k}.{name}": value.clone().contiguous() for name, value in of.items()}
        numbers = {"rate": optimiser["param_groups"][0]["lr"], "skipped": self._skipped}
        return tensors, numbers | {"schedule": {name: schedule[name] for name in _OF_SCHEDULE}}

    def restore(self, tensors: Mapping[str, Tensor], numbers: Mapping[str, Any]) -> None:
        """Take over what `state` gave, of a descent on parameters of the same shapes."""
        with torch.no_grad():
            for k, parameter in enumerate(self.parameters):
                parameter.copy_(tensors[f"parameter.{k}"])
        optimiser, self._skipped = self.optimiser.state_dict(), numbers["skipped"]
        of_parameters: dict[int, dict[str, Tensor]] = {}
        for name, value in tensors.items():
            kind, _, rest = name.partition(".")
            if kind == "adam":
                k, _, of = rest.partition(".")
                if value.ndim and value.shape != self.parameters[int(k)].shape:
                    raise ValueError(f"{name} has the shape {tuple(value.shape)}")
                of_parameters.setdefault(int(k), {})[of] = value.clone()
        if odd := [k for k, of in of_parameters.items() if set(of) != {"step", "exp_avg", "exp_avg_sq"}]:
            raise ValueError(f"parameter {odd[0]} has not what Adam keeps")
        optimiser["state"] = of_parameters
        optimiser["param_groups"][0]["lr"] = numbers["rate"]
        self.optimiser.load_state_dict(optimiser)
        self.schedule.load_state_dict(self.schedule.state_dict() | dict(numbers["schedule"]))


_OF_SCHEDULE = ("last_epoch", "_step_count", "_last_lr")  # what changes in the state of the schedule
