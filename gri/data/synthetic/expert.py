"""Synthetic scenes: an expert policy, trained on the true reward and graph, rolled out (Sec. VI-C)."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri.core.graph import FOLLOWING, InteractionGraph, Vocabulary
from gri.core.scenes import Scenes
from gri.data.ranges.car_following import GraphShare, SceneRange
from gri.data.ranges.highway_merge import HighwayMergeRange, leader_drive, sample_takeovers
from gri.data.ranges.lane_changing import LaneChangingRange, sample_merge
from gri.data.ranges.leader import leader_states, uniform
from gri.data.ranges.recorded import RecordedRange
from gri.networks.decoder import DecoderConfig
from gri.networks.encoder import EncoderConfig
from gri.networks.model import Edge, ModelConfig, RelationalModel
from gri.networks.rollout import rollout
from gri.progress import Progress, no_progress
from gri.rewards.structured import StructuredReward

Range = SceneRange | LaneChangingRange | HighwayMergeRange


def sample_starts(
    scenes: Range, count: int, generator: torch.Generator, steps: int | None = None
) -> tuple[Float[Tensor, "B 3 D"], Float[Tensor, "B T D"]]:
    """Initial states of three vehicles and the trajectory of the last one, the leader."""
    match scenes:
        case SceneRange():
            return sample_row(scenes, count, generator, steps)
        case LaneChangingRange():
            return sample_merge(scenes, count, generator, steps)
        case HighwayMergeRange():
            start = sample_takeovers(scenes, scenes.one_graph[0].situation, count, generator)
            leader = leader_drive(scenes, start[:, 2], generator)
            return torch.cat([start[:, :2], leader[:, :1]], 1), leader


def sample_row(
    scenes: SceneRange, count: int, generator: torch.Generator, steps: int | None = None
) -> tuple[Float[Tensor, "B 3 3"], Float[Tensor, "B T 3"]]:
    """Initial states of three vehicles in a row and the leader's trajectory."""
    starts, settled = scenes.starts, torch.rand(count, 1, generator=generator) < scenes.starts.settled
    speed = _speeds(scenes, count, generator)
    constants = scenes.reward.constants
    wanted = (constants.standstill + constants.time_headway * speed[:, :2]) * uniform(
        generator, 1 - starts.spread, 1 + starts.spread, count, 2
    )
    headway = torch.where(settled, wanted, uniform(generator, *starts.headway, count, 2))
    headway = headway.clamp(*starts.headway)
    zero = torch.zeros(count, 1)
    position = torch.cat([-headway.sum(1, keepdim=True), -headway[:, 1:], zero], 1)
    acceleration = torch.cat([uniform(generator, *starts.acceleration, count, 2), zero], 1)
    start = torch.stack([position, speed, acceleration], -1)
    leader = leader_states(scenes.leader, start[:, -1], steps or scenes.steps, scenes.dt, generator)
    return torch.cat([start[:, :-1], leader[:, None, 0]], 1), leader


def _speeds(scenes: SceneRange, count: int, generator: torch.Generator) -> Float[Tensor, "B 3"]:
    starts = scenes.starts
    if starts.speed_difference is None:
        return uniform(generator, *starts.speed, count, 3)
    difference = uniform(generator, -starts.speed_difference, starts.speed_difference, count, 2)
    leader = uniform(generator, *starts.speed, count, 1)
    middle = (leader + difference[:, 1:]).clamp(min=0)
    return torch.cat([(middle + difference[:, :1]).clamp(min=0), middle, leader], 1)


def sample_graphs(
    graphs: tuple[GraphShare, ...], count: int, generator: torch.Generator, vocabulary: Vocabulary = FOLLOWING
) -> Int[Tensor, "B E"]:
    """True graphs of `count` scenes, as type indices in the vocabulary."""
    table = torch.cat([_certain(graph.edges, vocabulary) for graph in graphs])
    shares = torch.tensor([float(g.share) for g in graphs])
    return table[torch.multinomial(shares, count, replacement=True, generator=generator)]


def _certain(edges: tuple[Edge, ...], vocabulary: Vocabulary) -> Int[Tensor, "1 E"]:
    return InteractionGraph.of_edges({(e.sender, e.receiver): e.type for e in edges}, vocabulary).map


def model_config(
    scenes: Range | RecordedRange,
    decoder: DecoderConfig,
    encoder: EncoderConfig | None,
    graph: tuple[Edge, ...] | None = None,
) -> ModelConfig:
    """A model that fits the scenes; without an encoder it believes in `graph`, by default the first of the
    range.
    """
    return ModelConfig(
        dynamics=scenes.dynamics,
        vocabulary=scenes.vocabulary,
        dt=scenes.dt,
        history_steps=scenes.history_steps,
        never_reverse=scenes.never_reverse,
        scale=scenes.scale,
        decoder=decoder,
        encoder=encoder,
        graph=scenes.one_graph[0].edges if graph is None else graph,
    )


def true_reward(scenes: Range) -> StructuredReward:
    """The reward the expert maximises."""
    return StructuredReward.with_weights(scenes.reward, scenes.weights).requires_grad_(False)


def train_expert(
    scenes: Range,
    graphs: tuple[GraphShare, ...],
    seed: int,
    updates: int = 1500,
    batch: int = 128,
    progress: Progress = no_progress,
) -> RelationalModel:
    """A policy that maximises the true return under the true graph by back-propagation through roll-outs.

    Each vehicle maximises its own return: what it makes the vehicle behind it do does not count, and over an
    edge of type 0 it sees nothing.
    """
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    expert, reward = RelationalModel(model_config(scenes, DecoderConfig(), None)), true_reward(scenes)
    optimiser = torch.optim.Adam(expert.parameters(), 3e-3, (0.9, 0.99))
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 3e-3, updates)
    for update in range(updates):
        start, leader = sample_starts(scenes, batch, generator)
        types = sample_graphs(graphs, batch, generator, scenes.vocabulary)
        one_hot = torch.nn.functional.one_hot(types, len(scenes.vocabulary)).float()
        value = mean_return(expert, reward, start, leader, one_hot)
        optimiser.zero_grad()
        (-value).backward()
        torch.nn.utils.clip_grad_norm_(expert.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        progress("expert", update + 1, updates, float(value.detach()))
    return expert.requires_grad_(False)


def mean_return(
    model: RelationalModel, reward: StructuredReward, start: Tensor, leader: Tensor, graph: Tensor
) -> Float[Tensor, ""]:
    """Mean reward per driven vehicle and step of the model's roll-outs, each vehicle on its own account."""
    driven = rollout(model, start, graph, leader, selfish=True)
    return returns(reward, driven.state, driven.action, graph).mean()


def returns(
    reward: StructuredReward,
    state: Float[Tensor, "B N T D"],
    action: Float[Tensor, "B R T-1 A"],
    graph: Float[Tensor, "B E K"],
) -> Float[Tensor, "B R T-1"]:
    """Reward of the driven vehicles at every step, without a gradient to the vehicles they react to."""
    idle = action.new_zeros(len(action), state.shape[1] - action.shape[1], *action.shape[2:])
    return reward(state[:, :, :-1], torch.cat([action, idle], 1), graph, cooperative=False)[:, : action.shape[1]]


@torch.no_grad()
def make_scenes(
    expert: RelationalModel,
    scenes: Range,
    graphs: tuple[GraphShare, ...],
    count: int,
    seed: int,
    action_noise: float = 0.0,
) -> Scenes:
    """Roll the expert out from random starts; `action_noise` is the standard deviation of its jerk [m/s³].

    Other actions are as noisy as the jerk, in units of the scale.
    """
    generator = torch.Generator().manual_seed(seed)
    start, leader = sample_starts(scenes, count, generator)
    types = sample_graphs(graphs, count, generator, scenes.vocabulary)
    spread = action_noise * torch.tensor(scenes.scale.action) / scenes.scale.action[0]
    normal = torch.randn(count, 2, scenes.steps - 1, len(spread), generator=generator)
    one_hot = torch.nn.functional.one_hot(types, len(scenes.vocabulary)).float()
    driven = rollout(expert, start, one_hot, leader, normal * spread / expert.decoder.sigma)
    return Scenes(driven.state, driven.action, types)
