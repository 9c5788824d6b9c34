"""A taught model drives as before, under a graph of its new encoder; it says what it does not know."""

import pytest
import torch

from gri import checkpoint
from gri.core.graph import pairs
from gri.core.trajectory import Trajectory
from gri.errors import InputError
from gri.networks.rollout import rollout
from gri.relations.reaction_scenes import ReactionPrior, draw_reactions
from gri.training.relations.teach_checkpoint import teach_model
from gri.training.relations.teach_encoder import TeachingSettings

TINY = TeachingSettings(
    prior=ReactionPrior(settle=(0.0,)), scenes=600, steps=25, updates=20, policy_updates=5, batch=32, window=(25, 25)
)


def known_states(generator: torch.Generator) -> torch.Tensor:
    scenes = draw_reactions(ReactionPrior(vehicles=3), 400, 25, 0.2, generator)
    return torch.stack([scenes.x, scenes.v, torch.zeros_like(scenes.x)], -1)


def test_reward_and_policy_stay_and_the_file_holds_all(generator: torch.Generator, tmp_path):
    model = checkpoint.load("us101_car_following")
    known = known_states(generator)
    taught, made = teach_model(model, known, TINY, 3)
    assert made["seed"] == 3
    assert made["settings"]["updates"] == 20
    checkpoint.save(tmp_path / "taught.safetensors", taught, None, {"teaching": made})
    loaded = checkpoint.load(tmp_path / "taught.safetensors")
    graph = loaded.infer(known[:5])
    assert torch.equal(graph.logits, taught.infer(known[:5]).logits)
    assert graph.unknown is not None
    assert float(graph.unknown.min()) >= 0
    start, leader = known[:5, :, -1], known[:5, -1, :10]
    edges = graph.one_hot
    first, second = (rollout(m, start, edges, leader).state for m in (model, loaded))
    assert torch.equal(first, second)
    history = Trajectory.complete(known[:5], 0.2)
    assert loaded.begin(history).graph is not None
    assert graph.logits.shape == (5, len(pairs(3)), 2)


@pytest.mark.slow
def test_the_same_seed_teaches_the_same_encoder(generator: torch.Generator):
    model, known = checkpoint.load("us101_car_following"), known_states(generator)
    first, second = (teach_model(model, known, TINY, 1)[0].state_dict() for _ in range(2))
    for name, tensor in first.items():
        assert torch.equal(tensor, second[name]), name


def test_models_with_other_edges_are_refused(generator: torch.Generator):
    with pytest.raises(InputError, match="wanted none and follow"):
        teach_model(checkpoint.load("us101_merge"), known_states(generator), TINY, 0)
