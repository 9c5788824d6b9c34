"""An encoder that learns the scenes' own graphs."""

import torch

from gri.data.recorded_ranges import SUMO_CAR_FOLLOWING
from gri.data.synthetic import Scenes, model_config
from gri.decoder import DecoderConfig
from gri.encoder import EncoderConfig
from gri.graph import EdgeType, InteractionGraph
from gri.model import RelationalModel
from gri.objectives.gri import GroundedSettings
from gri.objectives.told import ToldSettings, train_told
from gri.rewards import StructuredReward


def scenes(count: int = 16, steps: int = 8) -> Scenes:
    """Three vehicles at constant speed; the label says whether the gap ahead of vehicle 0 is small, the reward does
    not know it.
    """
    gap = torch.tensor([8.0, 40.0]).repeat(count // 2)
    start = torch.zeros(count, 3, 3)
    start[:, 1, 0], start[:, 2, 0], start[..., 1] = gap, gap + 20.0, 9.0
    state = start[:, :, None].repeat(1, 1, steps, 1)
    state[..., 0] += 9.0 * 0.2 * torch.arange(steps)
    edges = [{(2, 0): EdgeType.FOLLOW} if near < 10 else {} for near in gap.tolist()]
    graph = torch.cat([InteractionGraph.of_edges(edge, SUMO_CAR_FOLLOWING.vocabulary).map for edge in edges])
    return Scenes(state, torch.zeros(count, 2, steps - 1, 1), graph)


def test_the_encoder_learns_what_it_is_told():
    torch.manual_seed(0)
    config = model_config(SUMO_CAR_FOLLOWING, DecoderConfig(hidden=8), EncoderConfig(hidden=16, heads=4))
    model, reward, data = RelationalModel(config), StructuredReward(SUMO_CAR_FOLLOWING.reward), scenes()
    before = [psi.detach().clone() for psi in reward.psi.values()]
    grounded = GroundedSettings(
        reward_updates=2, reward_batch=4, reward_scenes=6, updates=3, batch=8, return_batch=4, encoder_rate=2e-2,
        encoder_lead=150, likelihood="stepwise",
    )  # fmt: skip
    train_told(model, reward, data, ToldSettings(grounded=grounded), seed=0)
    assert torch.equal(model.infer(data.seen).map, data.graph)
    assert any(not torch.equal(old, new) for old, new in zip(before, reward.psi.values(), strict=True))
