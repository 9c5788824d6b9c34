"""Synthetic scenes: roll-outs of an expert policy that was trained on the true reward and graph (Sec. VI-C)."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri.core.graph import FOLLOWING, InteractionGraph, Vocabulary
from gri.core.scenes import Scenes
from gri.data.ranges.car_following import SceneRange
from gri.data.ranges.graph_shares import GraphShare
from gri.data.ranges.highway_merge import HighwayMergeRange
from gri.data.ranges.highway_states import sample_leader, sample_takeovers
from gri.data.ranges.lane_changing import LaneChangingRange, sample_merge
from gri.data.ranges.leader import leader_states, uniform
from gri.data.ranges.recorded import RecordedRange
from gri.data.synthetic import idm_drivers
from gri.data.synthetic.idm_drivers import IdmExpert
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
    """Initial states of three vehicles, and the trajectory of the last one, the leader.

    T is `steps`, or the steps of the range. Units are those of the range's dynamics.
    """
    match scenes:
        case SceneRange():
            return sample_row(scenes, count, generator, steps)
        case LaneChangingRange():
            return sample_merge(scenes, count, generator, steps)
        case HighwayMergeRange():
            start = sample_takeovers(scenes, scenes.one_graph[0].situation, count, generator)
            leader = sample_leader(scenes, start[:, 2], generator)
            return torch.cat([start[:, :2], leader[:, :1]], 1), leader


def sample_row(
    scenes: SceneRange, count: int, generator: torch.Generator, steps: int | None = None
) -> tuple[Float[Tensor, "B 3 3"], Float[Tensor, "B T 3"]]:
    """Initial states (x [m], v [m/s], a [m/s²]) of three vehicles in one lane, and the leader's trajectory.

    With probability `settled`, the headways are near the IDM's equilibrium; else they are uniform.
    """
    starts, settled = scenes.starts, torch.rand(count, 1, generator=generator) < scenes.starts.settled
    speed = _sample_speeds(scenes, count, generator)
    constants = scenes.reward.constants
    equilibrium = (constants.standstill + constants.time_headway * speed[:, :2]) * uniform(
        generator, 1 - starts.spread, 1 + starts.spread, count, 2
    )
    headway = torch.where(settled, equilibrium, uniform(generator, *starts.headway, count, 2))
    headway = headway.clamp(*starts.headway)
    zero = torch.zeros(count, 1)
    position = torch.cat([-headway.sum(1, keepdim=True), -headway[:, 1:], zero], 1)
    acceleration = torch.cat([uniform(generator, *starts.acceleration, count, 2), zero], 1)
    start = torch.stack([position, speed, acceleration], -1)
    leader = leader_states(scenes.leader, start[:, -1], steps or scenes.steps, scenes.dt, generator)
    return torch.cat([start[:, :-1], leader[:, None, 0]], 1), leader


def _sample_speeds(scenes: SceneRange, count: int, generator: torch.Generator) -> Float[Tensor, "B 3"]:
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
    """Random true graphs of B = `count` scenes, as indices into the vocabulary; `graphs` gives their probabilities."""
    edges = ({(edge.sender, edge.receiver): edge.type for edge in graph.edges} for graph in graphs)
    table = torch.cat([InteractionGraph.of_edges(named, vocabulary).map for named in edges])
    shares = torch.tensor([float(g.share) for g in graphs])
    return table[torch.multinomial(shares, count, replacement=True, generator=generator)]


def model_config(
    scenes: Range | RecordedRange,
    decoder: DecoderConfig,
    encoder: EncoderConfig | None,
    graph: tuple[Edge, ...] | None = None,
) -> ModelConfig:
    """The configuration of a model for the scenes.

    Without an encoder the model always uses `graph`, or the first graph of the range if that is None.
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
    """The reward that the expert maximises, with the range's true weights (Sec. VI-C)."""
    return StructuredReward.with_weights(scenes.reward, scenes.weights).requires_grad_(False)


def train_expert(
    scenes: Range,
    graphs: tuple[GraphShare, ...],
    seed: int,
    updates: int = 1500,
    batch: int = 128,
    progress: Progress = no_progress,
) -> RelationalModel:
    """Train a policy to maximise the true return under the true graph, by back-propagation through roll-outs.

    `batch` is the number of starts per update. Each vehicle maximises its own return, so its effect on the vehicle
    behind does not count. Edges of type 0 carry no message.
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
    """Mean reward per driven vehicle and step of roll-outs from `start` [B, N, D] with the one-hot `graph` [B, E, K].

    `leader` [B, T, D] is the leader's trajectory. No gradient flows from a vehicle's reward to other vehicles.
    """
    driven = rollout(model, start, graph, leader, detach_senders=True)
    return returns(reward, driven.state, driven.action, graph).mean()


def returns(
    reward: StructuredReward,
    state: Float[Tensor, "B N T D"],
    action: Float[Tensor, "B R T-1 A"],
    graph: Float[Tensor, "B E K"],
) -> Float[Tensor, "B R T-1"]:
    """Reward of each driven vehicle at every step (Eq. reward), without a gradient to the vehicles it reacts to."""
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
    """Roll-outs of the expert from `count` random starts.

    `action_noise` is the standard deviation of independent noise on the jerk [m/s³]. Other actions get the same noise
    relative to the units of the scale.
    """
    generator = torch.Generator().manual_seed(seed)
    start, leader = sample_starts(scenes, count, generator)
    types = sample_graphs(graphs, count, generator, scenes.vocabulary)
    spread = action_noise * torch.tensor(scenes.scale.action) / scenes.scale.action[0]
    normal = torch.randn(count, 2, scenes.steps - 1, len(spread), generator=generator)
    one_hot = torch.nn.functional.one_hot(types, len(scenes.vocabulary)).float()
    driven = rollout(expert, start, one_hot, leader, normal * spread / expert.decoder.sigma)
    return Scenes(driven.state, driven.action, types)


def make_idm_scenes(
    drivers: IdmExpert,
    scenes: SceneRange,
    graphs: tuple[GraphShare, ...],
    count: int,
    seed: int,
    action_noise: float = 0.0,
) -> Scenes:
    """Scenes of IDM drivers from `count` random starts; `action_noise` as in `make_scenes`."""
    generator = torch.Generator().manual_seed(seed)
    start, leader = sample_row(scenes, count, generator)
    types = sample_graphs(graphs, count, generator, scenes.vocabulary)
    return idm_drivers.drive(drivers, start, leader, types, scenes.dt, action_noise, generator)
