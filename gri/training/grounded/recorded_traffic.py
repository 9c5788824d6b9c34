"""Grounded training on recorded traffic: the stages of `train_grounded`, with a reward that has networks in it.

The references h of the reward are fitted with its weights: the likelihood of the recorded actions, summed over all
graphs, is expanded anew at every update. Graph and policy are then learned as from any other reward.
"""

from typing import Annotated

import msgspec
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gri.core.graph import EdgeType
from gri.core.layers import edge_ends
from gri.core.scenes import Scenes
from gri.networks.model import RelationalModel
from gri.planning.laplace_likelihood import combination_prior, marginals, scene_prior
from gri.planning.riccati_likelihood import expand_steps, log_likelihood_by_steps
from gri.progress import Progress, no_progress
from gri.rewards.structured import StructuredReward
from gri.training.grounded.policy_posterior import posterior_by_policy
from gri.training.grounded.settings import GroundedSettings
from gri.training.grounded.train_grounded import fit_encoder_and_policy, plan
from gri.training.optimisation import Descent, batches


class RecordedSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="gri_recorded"):
    """The stages' settings; those of the reward are here, `grounded.reward_*` are not used."""

    grounded: GroundedSettings
    reward_updates: int = 150
    reward_rate: float = 0.05
    """Of weights and α."""
    reference_rate: float = 3e-3
    reward_batch: int = 24
    speed_bin: float | None = None
    """Draw scenes evenly over ranges of mean speed so wide [m/s] for the reward, and for the encoder while it moves
    alone; None: as they come.

    Recorded traffic is mostly slow, and references that fit slow traffic take fast vehicles for unrelated ones.
    """
    no_follow_prior: Annotated[float, msgspec.Meta(gt=0, lt=1)] | None = None
    """Probability that a vehicle does not follow the one ahead of it in its lane; None: `grounded.no_edge_prior`."""
    log_alpha: float = -1.5
    """Logarithm of the drivers' rationality before training; people are less exact than 0 would have them."""


def train_recorded(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: RecordedSettings,
    seed: int,
    progress: Progress = no_progress,
) -> None:
    """Train the model and the reward in place."""
    generator, grounded = torch.Generator().manual_seed(seed), settings.grounded
    scenes = scenes[torch.randperm(len(scenes), generator=generator)]  # a file has its sites one after the other
    fit_references(model, reward, scenes, settings, generator, progress)
    judged = scenes[: grounded.graph_scenes]
    if grounded.judge == "policy":
        plan(model, reward, scenes, grounded, generator, progress)
        posterior = posterior_by_policy(model, reward, judged, recorded_prior(reward, judged.state, settings))
    else:
        posterior = recorded_posterior(model, reward, judged, settings, progress)
    weight = _weights(model, judged, settings)
    fit_encoder_and_policy(model, reward, scenes, posterior, grounded, generator, progress, weight)


def fit_references(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: RecordedSettings,
    generator: torch.Generator,
    progress: Progress = no_progress,
) -> None:
    """Maximise Σ_j log Σ_z p(z_j)·p(u_j | z_j) over weights, α and reference networks."""
    total = settings.reward_updates
    assert reward.references is not None, "recorded traffic wants a reward with references"
    reward.log_alpha.data.fill_(settings.log_alpha)
    to_references = Descent(reward.references.parameters(), settings.reference_rate, total, clip=1.0)
    to_weights = Descent([*reward.psi.parameters(), reward.log_alpha], settings.reward_rate, total, clip=1.0)
    drawn = batches(len(scenes), settings.reward_batch, total, generator, _weights(model, scenes, settings))
    for update, chosen in enumerate(drawn):
        batch = scenes[chosen]
        likelihood = _likelihood(model, reward, batch, learn=True)
        prior = recorded_prior(reward, batch.state, settings)
        evidence = torch.logsumexp(likelihood + combination_prior(reward, prior, batch.action.shape[1]), -1).mean()
        gradients = to_references.gradients(-evidence, retain_graph=True)
        to_weights.step(-evidence)
        to_references.apply(gradients)
        progress("reward and references", update + 1, total, float(evidence.detach()))


def _likelihood(
    model: RelationalModel, reward: StructuredReward, scenes: Scenes, learn: bool = False
) -> Float[Tensor, "B R C"]:
    """log p(u_j | z_j), in double precision.

    Where paths are nearly parallel, lateral speed moves the point of collision by kilometres per m/s, and single
    precision is nats off or finds the logarithm of a negative number.
    """
    expansion = expand_steps(model, reward, scenes.state, scenes.action, learn)
    return log_likelihood_by_steps(reward, expansion.double()).to(scenes.state.dtype)


def _weights(model: RelationalModel, scenes: Scenes, settings: RecordedSettings) -> Float[Tensor, " S"] | None:
    """How often scenes are drawn for the reward and for an encoder that moves alone."""
    if settings.speed_bin is None:
        return None
    return even_weights(scenes.state[:, :-1, :, model.dynamics.speed].mean((1, 2)), settings.speed_bin)


def even_weights(speed: Float[Tensor, " S"], width: float) -> Float[Tensor, " S"]:
    """How often scenes are drawn so that each range of speeds counts alike; ranges with fewer than `FEW` count less."""
    bins = (speed / width).long()
    return 1 / bins.bincount()[bins].clamp(min=FEW).to(speed.dtype)


FEW = 20
"""Scenes of a rare speed weigh as if there were so many."""


def recorded_prior(
    reward: StructuredReward, state: Float[Tensor, "B N T D"], settings: RecordedSettings
) -> Float[Tensor, "B E K"]:
    """p(z_ij): the sparse prior, and the paper's definition of the types (Sec. VI-D).

    A vehicle follows its preceding vehicle in the same lane and yields to the one in the lane beside it: the nearest
    there that ends up ahead (`ahead_only`). Lanes are those of the first step. Which of these edges are there is not
    said; how vehicles move along the road would hardly tell what kind they are.
    """
    grounded = settings.grounded
    prior = scene_prior(reward, state, grounded.no_edge_prior, grounded.ahead_only)
    senders, receivers = edge_ends(state.shape[1])
    lane = same_lane(reward, state)
    together = lane[:, senders, receivers]
    followable = together
    if grounded.ahead_only:
        next_ahead = preceding(state[:, :, -1, 0], lane)[:, senders, receivers]
        unlikely = IMPOSSIBLE if EdgeType.YIELD in reward.vocabulary else 1e-12
        prior[..., 1:] = prior[..., 1:].masked_fill(~next_ahead[..., None], unlikely)
        followable = together & next_ahead
    if EdgeType.YIELD in reward.vocabulary:
        for kind, excluded in ((EdgeType.FOLLOW, ~together), (EdgeType.YIELD, together)):
            k = reward.vocabulary.index(kind)
            prior[..., k] = prior[..., k].masked_fill(excluded, IMPOSSIBLE)
    if settings.no_follow_prior is not None:
        none, follow = (reward.vocabulary.index(kind) for kind in (EdgeType.NONE, EdgeType.FOLLOW))
        alone = prior[..., follow] * settings.no_follow_prior / (1 - settings.no_follow_prior)
        prior[..., none] = torch.where(followable, alone, prior[..., none])
    return prior / prior.sum(-1, keepdim=True)


IMPOSSIBLE = 1e-37
"""Probability of what a type excludes by definition: no likelihood makes up for it, and its logarithm is finite."""


def same_lane(reward: StructuredReward, state: Float[Tensor, "B N T D"]) -> Bool[Tensor, "B N N"]:
    """Which vehicles share a lane at the first step; all where there is one lane."""
    if EdgeType.YIELD not in reward.vocabulary:
        return torch.ones(len(state), state.shape[1], state.shape[1], dtype=torch.bool)
    y = state[:, :, 0, 1]
    return (y[:, :, None] - y[:, None]).abs() <= BESIDE


def preceding(x: Float[Tensor, "B N"], lane: Bool[Tensor, "B N N"]) -> Bool[Tensor, "B N N"]:
    """[i, j]: i is ahead of j, and nobody of i's lane is between them."""
    ahead = x[:, :, None] > x[:, None]
    between = torch.einsum("bik,bkj,bki->bij", *(m.float() for m in (ahead, ahead, lane))) > 0
    return ahead & ~between


BESIDE = 1.5
"""Vehicles farther apart sideways are in different lanes [m]: nearly half a lane, as many are not in its middle."""


@torch.no_grad()
def recorded_posterior(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: RecordedSettings,
    progress: Progress = no_progress,
    chunk: int = 256,
) -> Float[Tensor, "S E K"]:
    """p(z_ij | u) of every scene under the reward as it stands."""
    parts = []
    for start in range(0, len(scenes), chunk):
        part = scenes[start : start + chunk]
        likelihood = _likelihood(model, reward, part)
        parts.append(marginals(reward, likelihood, recorded_prior(reward, part.state, settings)))
        progress("graph", min(start + chunk, len(scenes)), len(scenes), 0.0)
    return torch.cat(parts)
