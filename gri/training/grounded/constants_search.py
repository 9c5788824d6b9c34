"""Learn the constants of drivers together with the reward's weights, from first values that may be wrong by a factor.

What a driver wants (time headway, standstill gap, comfort, wished speed, ...) is a parameter of the reward with a broad
log-normal prior around the first value. The constants θ, the weights ψ and the rationality α maximise

    Σ_j log Σ_z p(z_j)·p(u_j | z_j, θ, ψ, α) + log p(θ),

the likelihood of the recorded actions summed over all graphs. No label is used. The maximum is searched from several
starts: constants far from the truth explain every vehicle as one without edges, and there the gradient vanishes.
"""

from dataclasses import dataclass

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.scenes import Scenes
from gri.networks.model import RelationalModel
from gri.planning.edge_posterior import combination_prior, scene_prior
from gri.planning.riccati_likelihood import expand_steps, log_likelihood_by_steps
from gri.progress import Progress, no_progress
from gri.rewards.structured import StructuredReward
from gri.training.optimisation import Descent, draw_batch
from gri.training.training_state import TrainingState, no_state


class ConstantsSearch(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The prior of the constants, and how the maximum is searched."""

    spread: float = 0.7
    """Standard deviation of the logarithm of each constant around its first value; 0.7 is a factor of 2."""
    draws: int = 64
    """Constants drawn from the prior; the first values are one more draw."""
    screening_scenes: int = 32
    """Scenes on which the draws are compared."""
    scenes: int = 128
    """Scenes on which the constants are learned."""
    rounds: tuple[tuple[int, int], ...] = ((6, 40), (2, 120))
    """In each round the best candidates so far are updated: (number of candidates, number of updates)."""
    rate: float = 0.05
    batch: int = 16


LOG_ALPHAS = (-2.0, -1.0, 0.0, 1.0, 2.0, 3.0)
"""Values of log α with which every draw of constants is tried."""


@dataclass(frozen=True)
class LearnedReward:
    """Parameters of a reward, and the mean log-likelihood per vehicle that they reach [nats]."""

    evidence: float
    parameters: dict[str, Tensor]


def search_constants(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    search: ConstantsSearch,
    weight_prior: float,
    no_edge_prior: float,
    generator: torch.Generator,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> None:
    """Learn the constants, the weights and the rationality of the reward in place.

    `weight_prior` is the weight of Σψ² relative to the mean log-likelihood per vehicle [nats].
    """
    assert reward.constants is not None, "got a reward with given constants, wanted one that learns them"
    scenes = scenes[torch.randperm(len(scenes), generator=generator)[: search.scenes]]
    ranked = _screened(model, reward, scenes[: search.screening_scenes], search, no_edge_prior, generator)
    total, done = sum(kept * updates for kept, updates in search.rounds), 0

    def improved(start: LearnedReward, updates: int) -> LearnedReward:
        nonlocal done
        before = done
        reward.load_state_dict(start.parameters)
        descent = Descent(reward.parameters(), search.rate, updates)
        for update in (state or no_state()).updates("constants", updates, generator, descent):
            chosen = draw_batch(len(scenes), search.batch, generator)
            gained = evidence(model, reward, scenes[chosen], no_edge_prior, learn=True).mean()
            descent.step(_penalty(reward, search, weight_prior, len(scenes)) - gained)
            progress("constants", before + update + 1, total, float(gained.detach()))
        done = before + updates
        return _reached(model, reward, scenes, no_edge_prior)

    for kept, updates in search.rounds:
        found = [improved(start, updates) for start in ranked[:kept]]
        ranked = sorted(found, key=lambda learned: -learned.evidence)
    reward.load_state_dict(ranked[0].parameters)


def evidence(
    model: RelationalModel, reward: StructuredReward, scenes: Scenes, no_edge_prior: float, learn: bool = False
) -> Float[Tensor, "S R"]:
    """log Σ_z p(z_j)·p(u_j | z_j) of every driven vehicle [nats]; with `learn`, differentiable in the constants."""
    expansion = expand_steps(model, reward, scenes.state, scenes.action, learn)
    prior = combination_prior(reward, scene_prior(reward, scenes.state, no_edge_prior), scenes.action.shape[1])
    return torch.logsumexp(log_likelihood_by_steps(reward, expansion) + prior, -1)


def _penalty(reward: StructuredReward, search: ConstantsSearch, weight_prior: float, scenes: int) -> Float[Tensor, ""]:
    """−log p(θ) per driven vehicle, and the prior of the weights."""
    assert reward.constants is not None
    squares = torch.cat([psi.square() for psi in reward.psi.values()]).sum()
    constants = (reward.constants.log_ratio / search.spread).square().sum() / 2
    return constants / (2 * scenes) + weight_prior * squares


@torch.no_grad()
def _screened(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    search: ConstantsSearch,
    no_edge_prior: float,
    generator: torch.Generator,
) -> list[LearnedReward]:
    """The draws from the prior, each with its best α, from the most to the least likely."""
    assert reward.constants is not None
    prior = combination_prior(reward, scene_prior(reward, scenes.state, no_edge_prior), scenes.action.shape[1])
    draws = search.spread * torch.randn(search.draws + 1, len(reward.constants.log_ratio), generator=generator)
    draws[0] = 0.0
    found = []
    for draw in draws:
        reward.constants.log_ratio.copy_(draw)
        expansion = expand_steps(model, reward, scenes.state, scenes.action)
        tried = []
        for log_alpha in LOG_ALPHAS:
            reward.log_alpha.fill_(log_alpha)
            likelihood = log_likelihood_by_steps(reward, expansion) + prior
            tried.append(LearnedReward(float(torch.logsumexp(likelihood, -1).mean()), _parameters(reward)))
        found.append(max(tried, key=lambda learned: learned.evidence))
    return sorted(found, key=lambda learned: -learned.evidence)


@torch.no_grad()
def _reached(model: RelationalModel, reward: StructuredReward, scenes: Scenes, no_edge_prior: float) -> LearnedReward:
    return LearnedReward(float(evidence(model, reward, scenes, no_edge_prior).mean()), _parameters(reward))


def _parameters(reward: StructuredReward) -> dict[str, Tensor]:
    return {name: tensor.detach().clone() for name, tensor in reward.state_dict().items()}
