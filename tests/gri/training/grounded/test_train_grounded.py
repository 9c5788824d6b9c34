"""Options of the grounded training."""

import msgspec
import pytest
import torch

from gri.core.graph import InteractionGraph
from gri.core.scenes import Scenes
from gri.data.ranges.car_following import PAPER
from gri.data.synthetic.expert import make_scenes, model_config
from gri.networks.decoder import DecoderConfig
from gri.networks.encoder import EncoderConfig
from gri.networks.model import RelationalModel
from gri.networks.rollout import rollout
from gri.rewards.structured import StructuredReward
from gri.training.grounded import train_grounded as grounded
from gri.training.grounded.reward_likelihood import fit_reward
from gri.training.grounded.settings import GroundedSettings
from gri.training.grounded.train_grounded import train_grounded


@pytest.fixture
def model() -> RelationalModel:
    torch.manual_seed(0)
    return RelationalModel(model_config(PAPER, DecoderConfig(hidden=8), EncoderConfig(hidden=8, heads=2)))


@pytest.fixture
def scenes(model: RelationalModel) -> Scenes:
    return make_scenes(model, PAPER, PAPER.one_graph, count=16, seed=0)


def fitted(model: RelationalModel, scenes: Scenes, prior: float) -> dict[str, float]:
    """Distance of every group of ψ from 0 after the fit."""
    reward = StructuredReward(PAPER.reward)
    settings = GroundedSettings(reward_updates=30, reward_rate=0.1, reward_prior=prior)
    fit_reward(model, reward, scenes, settings, torch.Generator().manual_seed(0))
    return {name: float(psi.detach().norm()) for name, psi in reward.psi.items()}


def test_the_prior_keeps_weights_at_one_unit_each(model: RelationalModel, scenes: Scenes):
    free, held = fitted(model, scenes, 0.0), fitted(model, scenes, 1000.0)
    assert all(held[name] < 0.3 * free[name] for name in free)


def test_scenes_are_reproduced_under_the_most_probable_graph(
    model: RelationalModel, scenes: Scenes, monkeypatch: pytest.MonkeyPatch
):
    def refuse(graph: InteractionGraph, generator: torch.Generator) -> torch.Tensor:
        raise AssertionError("drew a graph")

    monkeypatch.setattr(InteractionGraph, "sample", refuse)
    reward = StructuredReward(PAPER.reward)
    drawn = GroundedSettings(reward_updates=1, reward_scenes=4, updates=1, batch=4, return_batch=2)
    train_grounded(model, reward, scenes, msgspec.structs.replace(drawn, reconstruction="likely"), 0)
    with pytest.raises(AssertionError, match="drew a graph"):
        train_grounded(model, reward, scenes, drawn, 0)


def test_scenes_are_reproduced_under_the_graph_that_their_actions_show(
    model: RelationalModel, scenes: Scenes, monkeypatch: pytest.MonkeyPatch
):
    """Those that have a posterior, under its most probable graph, whatever the encoder makes of them."""
    told = torch.eye(2)[torch.tensor([[1, 0, 0, 1, 0, 1], [0, 1, 1, 0, 1, 0]])]
    monkeypatch.setattr(grounded, "scene_posterior", lambda *_: told)
    used = []

    def watched(model: RelationalModel, start: torch.Tensor, graph: torch.Tensor, *others, **options):
        used.append((start, graph))
        return rollout(model, start, graph, *others, **options)

    monkeypatch.setattr(grounded, "rollout", watched)
    settings = GroundedSettings(
        reward_updates=1, reward_scenes=4, updates=3, batch=4, return_batch=2, reconstruction="judged", graph_scenes=2
    )
    train_grounded(model, StructuredReward(PAPER.reward), scenes, settings, 0)
    for start, graph in used[::2]:  # the others are those of the return
        for one, driving_graph in zip(start, graph, strict=True):
            (scene,) = (k for k in range(2) if torch.equal(one, scenes.start[k]))
            assert torch.equal(driving_graph, told[scene])


def test_the_encoder_may_be_done_before_the_policy(scenes: Scenes):
    def trained(updates: int, encoder_updates: int | None) -> RelationalModel:
        torch.manual_seed(0)
        model = RelationalModel(model_config(PAPER, DecoderConfig(hidden=8), EncoderConfig(hidden=8, heads=2)))
        settings = GroundedSettings(
            reward_updates=1, reward_scenes=4, updates=updates, encoder_updates=encoder_updates, batch=4, return_batch=2
        )
        train_grounded(model, StructuredReward(PAPER.reward), scenes, settings, 0)
        return model

    early, stopped = trained(2, None), trained(4, 2)
    assert early.encoder is not None
    assert stopped.encoder is not None
    for before, after in zip(early.encoder.parameters(), stopped.encoder.parameters(), strict=True):
        assert torch.equal(before, after)
    same = [torch.equal(a, b) for a, b in zip(early.decoder.parameters(), stopped.decoder.parameters(), strict=True)]
    assert not all(same)
