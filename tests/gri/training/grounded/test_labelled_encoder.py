"""An encoder that learns the scenes' own graphs."""

from pathlib import Path

import pytest
import torch

from gri import checkpoint
from gri.core.graph import EdgeType, InteractionGraph
from gri.core.scenes import Scenes
from gri.data.ranges.recorded import SUMO_CAR_FOLLOWING
from gri.data.synthetic.expert import model_config
from gri.errors import InputError
from gri.networks.decoder import DecoderConfig
from gri.networks.encoder import EncoderConfig
from gri.networks.model import RelationalModel
from gri.rewards.structured import StructuredReward
from gri.training.grounded.labelled_encoder import LabelledEncoderSettings, train_labelled_encoder
from gri.training.grounded.settings import GroundedSettings


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


def driver(hidden: int = 8) -> tuple[RelationalModel, StructuredReward]:
    config = model_config(SUMO_CAR_FOLLOWING, DecoderConfig(hidden=hidden), EncoderConfig(hidden=16, heads=4))
    return RelationalModel(config), StructuredReward(SUMO_CAR_FOLLOWING.reward)


def test_the_encoder_learns_what_it_is_told():
    torch.manual_seed(0)
    (model, reward), data = driver(), scenes()
    before = [psi.detach().clone() for psi in reward.psi.values()]
    grounded = GroundedSettings(
        reward_updates=2, reward_batch=4, reward_scenes=6, updates=3, batch=8, return_batch=4, encoder_rate=2e-2,
        encoder_lead=150, likelihood="stepwise",
    )  # fmt: skip
    train_labelled_encoder(model, reward, data, LabelledEncoderSettings(grounded=grounded), seed=0)
    assert torch.equal(model.infer(data.observed).map, data.graph)
    assert any(not torch.equal(old, new) for old, new in zip(before, reward.psi.values(), strict=True))


def test_a_trained_policy_and_its_reward_stay_without_updates(tmp_path: Path):
    torch.manual_seed(0)
    (trained, its_reward), path = driver(), tmp_path / "driver.safetensors"
    its_reward.psi["follow"].data += 0.5
    checkpoint.save(path, trained, its_reward)
    (model, reward), data = driver(), scenes()
    untold = GroundedSettings(updates=0, batch=8, encoder_rate=2e-2, encoder_lead=150)
    train_labelled_encoder(model, reward, data, LabelledEncoderSettings(grounded=untold, start=str(path)), seed=0)
    assert torch.equal(model.infer(data.observed).map, data.graph)
    assert torch.equal(reward.psi["follow"], its_reward.psi["follow"])
    policies = model.decoder.state_dict(), trained.decoder.state_dict()
    assert all(torch.equal(policies[0][name], tensor) for name, tensor in policies[1].items())


def test_a_start_of_another_size_or_without_a_reward_is_refused(tmp_path: Path):
    (model, reward), path = driver(), tmp_path / "driver.safetensors"
    settings = LabelledEncoderSettings(grounded=GroundedSettings(), start=str(path))
    checkpoint.save(path, driver(hidden=4)[0], reward)
    with pytest.raises(InputError, match="got decoder"):
        train_labelled_encoder(model, reward, scenes(), settings, seed=0)
    checkpoint.save(path, driver()[0])
    with pytest.raises(InputError, match="a checkpoint without a reward"):
        train_labelled_encoder(model, reward, scenes(), settings, seed=0)
