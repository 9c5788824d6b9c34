"""Grounded training on recorded traffic: the stages of `train_grounded`, with a reward that contains networks.

The reference networks h of the reward (Sec. VI-D) are fitted together with its weights. For this, the likelihood of the
recorded actions, summed over all graphs, is expanded again at every update. Graph and policy are then learned as with
other rewards.
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
from gri.planning.edge_posterior import UNLIKELY, combination_prior, marginals, scene_prior
from gri.planning.riccati_likelihood import expand_steps, log_likelihood_by_steps
from gri.progress import Progress, no_progress
from gri.rewards.structured import StructuredReward
from gri.training.grounded.policy_posterior import posterior_by_policy
from gri.training.grounded.settings import GroundedSettings
from gri.training.grounded.train_grounded import fit_encoder_and_policy, plan_policy
from gri.training.optimisation import Descent, draw_batch
from gri.training.training_state import TrainingState, no_state


class RecordedSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="gri_recorded"):
    """The settings of the stages. The reward's settings are these; `grounded.reward_*` are not used."""

    grounded: GroundedSettings
    reward_updates: int = 150
    reward_rate: float = 0.05
    """Learning rate of the weights and α."""
    reference_rate: float = 3e-3
    """Learning rate of the reference networks."""
    reward_batch: int = 24
    speed_bin: float | None = None
    """Width of the bins of mean speed over which scenes are sampled evenly [m/s]; None: all scenes are equal.

    This applies to the reward, and to the encoder while it is trained alone. Recorded traffic is mostly slow, and a
    reward that was fitted to slow traffic infers no edges between fast vehicles.
    """
    no_follow_prior: Annotated[float, msgspec.Meta(gt=0, lt=1)] | None = None
    """Prior probability that a vehicle does not follow its preceding vehicle; None: `grounded.no_edge_prior`."""
    by_definition: bool | msgspec.UnsetType = msgspec.UNSET
    """False: a flat prior, the same odds for every pair. Not set: what the definitions allow (`recorded_prior`)."""
    log_alpha: float = -1.5
    """Initial value of log α, the logarithm of the drivers' rationality. People are less exact than 0 implies."""


def train_recorded(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: RecordedSettings,
    seed: int,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> None:
    """Train the model and the reward in place. The model must have an encoder. Graphs of scenes are not used."""
    generator, grounded = torch.Generator().manual_seed(seed), settings.grounded
    scenes = scenes[torch.randperm(len(scenes), generator=generator)]  # a file contains one site after the other
    fit_references(model, reward, scenes, settings, generator, progress, state)
    graph_scenes = scenes[: grounded.graph_scenes]
    if grounded.judge == "policy":
        plan_policy(model, reward, scenes, grounded, generator, progress, state)
        posterior = posterior_by_policy(
            model, reward, graph_scenes, recorded_prior(reward, graph_scenes.state, settings)
        )
    else:
        posterior = recorded_posterior(model, reward, graph_scenes, settings, progress)
    weight = _scene_weights(model, graph_scenes, settings)
    fit_encoder_and_policy(model, reward, scenes, posterior, grounded, generator, progress, weight, state)


def fit_references(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: RecordedSettings,
    generator: torch.Generator,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> None:
    """Fit the reward's weights, α and reference networks in place: maximise Σ_j log Σ_z p(z_j)·p(u_j | z_j)."""
    total = settings.reward_updates
    assert reward.references is not None, (
        "got a reward without reference networks; recorded traffic needs one with them"
    )
    reward.log_alpha.data.fill_(settings.log_alpha)
    reference_descent = Descent(reward.references.parameters(), settings.reference_rate, total, clip=1.0)
    weight_descent = Descent([*reward.psi.parameters(), reward.log_alpha], settings.reward_rate, total, clip=1.0)
    weight, descents = _scene_weights(model, scenes, settings), (reference_descent, weight_descent)
    for update in (state or no_state()).updates("reward and references", total, generator, *descents):
        batch = scenes[draw_batch(len(scenes), settings.reward_batch, generator, weight)]
        likelihood = _likelihood(model, reward, batch, learn=True)
        prior = recorded_prior(reward, batch.state, settings)
        evidence = torch.logsumexp(likelihood + combination_prior(reward, prior, batch.action.shape[1]), -1).mean()
        gradients = reference_descent.gradients(-evidence, retain_graph=True)
        weight_descent.step(-evidence)
        reference_descent.apply(gradients)
        progress("reward and references", update + 1, total, float(evidence.detach()))


def _likelihood(
    model: RelationalModel, reward: StructuredReward, scenes: Scenes, learn: bool = False
) -> Float[Tensor, "B R C"]:
    """log p(u_j | z_j) for all C combinations of the edges into each vehicle, computed in double precision.

    On nearly parallel paths, the point of collision moves by kilometres per m/s of lateral speed. Single precision then
    has errors of several nats, or takes the logarithm of a negative number.
    """
    expansion = expand_steps(model, reward, scenes.state, scenes.action, learn)
    return log_likelihood_by_steps(reward, expansion.double()).to(scenes.state.dtype)


def _scene_weights(model: RelationalModel, scenes: Scenes, settings: RecordedSettings) -> Float[Tensor, " S"] | None:
    """Relative probabilities of the scenes while the reward, or the encoder alone, is trained; None: all equal."""
    if settings.speed_bin is None:
        return None
    return speed_balanced_weights(scenes.state[:, :-1, :, model.dynamics.speed].mean((1, 2)), settings.speed_bin)


def speed_balanced_weights(speed: Float[Tensor, " S"], width: float) -> Float[Tensor, " S"]:
    """Relative probabilities of scenes with which all bins of mean speed, `width` [m/s] wide, have the same share.

    Bins with fewer than `MIN_SCENES_PER_BIN` scenes have a smaller share.
    """
    bins = (speed / width).long()
    return 1 / bins.bincount()[bins].clamp(min=MIN_SCENES_PER_BIN).to(speed.dtype)


MIN_SCENES_PER_BIN = 20
"""Smallest number of scenes of a bin in the weights, so that a few scenes do not dominate."""


def recorded_prior(
    reward: StructuredReward, state: Float[Tensor, "B N T D"], settings: RecordedSettings
) -> Float[Tensor, "B E K"]:
    """p(z_ij): the sparse prior, with the types that the paper's definition excludes (Sec. VI-D).

    A vehicle can follow only its preceding vehicle in the same lane, and yield only to the preceding one in the
    adjacent lane. With `ahead_only`, preceding means the nearest vehicle of the lane that is ahead at the last step.
    Lanes are those of the first step. Longitudinal motion alone would hardly distinguish the two types. The prior does
    not say which of the possible edges exist. With `by_definition` false, all pairs have the sparse prior.
    """
    grounded = settings.grounded
    if settings.by_definition is False:
        return scene_prior(reward, state, grounded.no_edge_prior)
    prior = scene_prior(reward, state, grounded.no_edge_prior, grounded.ahead_only)
    senders, receivers = edge_ends(state.shape[1])
    lane = same_lane(reward, state)
    in_lane = lane[:, senders, receivers]
    can_follow = in_lane
    if grounded.ahead_only:
        nearest_ahead = is_preceding(state[:, :, -1, 0], lane)[:, senders, receivers]
        unlikely = IMPOSSIBLE if EdgeType.YIELD in reward.vocabulary else UNLIKELY
        prior[..., 1:] = prior[..., 1:].masked_fill(~nearest_ahead[..., None], unlikely)
        can_follow = in_lane & nearest_ahead
    if EdgeType.YIELD in reward.vocabulary:
        for kind, excluded in ((EdgeType.FOLLOW, ~in_lane), (EdgeType.YIELD, in_lane)):
            k = reward.vocabulary.index(kind)
            prior[..., k] = prior[..., k].masked_fill(excluded, IMPOSSIBLE)
    if settings.no_follow_prior is not None:
        none, follow = (reward.vocabulary.index(kind) for kind in (EdgeType.NONE, EdgeType.FOLLOW))
        no_follow = prior[..., follow] * settings.no_follow_prior / (1 - settings.no_follow_prior)
        prior[..., none] = torch.where(can_follow, no_follow, prior[..., none])
    return prior / prior.sum(-1, keepdim=True)


IMPOSSIBLE = 1e-37
"""Prior probability of an excluded type: its logarithm is finite, but no likelihood outweighs it."""


def same_lane(reward: StructuredReward, state: Float[Tensor, "B N T D"]) -> Bool[Tensor, "B N N"]:
    """Whether two vehicles share a lane at the first step; true for all pairs if vehicles cannot change lanes."""
    if EdgeType.YIELD not in reward.vocabulary:
        return torch.ones(len(state), state.shape[1], state.shape[1], dtype=torch.bool)
    y = state[:, :, 0, 1]
    return (y[:, :, None] - y[:, None]).abs() <= SAME_LANE_DISTANCE


def is_preceding(x: Float[Tensor, "B N"], lane: Bool[Tensor, "B N N"]) -> Bool[Tensor, "B N N"]:
    """[i, j]: i is ahead of j, and no other vehicle of i's lane is between them; `x` are positions along the road."""
    ahead = x[:, :, None] > x[:, None]
    between = torch.einsum("bik,bkj,bki->bij", *(m.float() for m in (ahead, ahead, lane))) > 0
    return ahead & ~between


SAME_LANE_DISTANCE = 1.5
"""Largest lateral distance of vehicles in the same lane [m]: nearly half a lane, as many do not drive in its middle."""


@torch.no_grad()
def recorded_posterior(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: RecordedSettings,
    progress: Progress = no_progress,
    chunk: int = 256,
) -> Float[Tensor, "S E K"]:
    """p(z_ij | u) of every scene under the present reward. `chunk` scenes are in memory at once."""
    parts = []
    for start in range(0, len(scenes), chunk):
        part = scenes[start : start + chunk]
        likelihood = _likelihood(model, reward, part)
        parts.append(marginals(reward, likelihood, recorded_prior(reward, part.state, settings)))
        progress("graph", min(start + chunk, len(scenes)), len(scenes), 0.0)
    return torch.cat(parts)
