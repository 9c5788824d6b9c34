"""A taught model drives as before, under a graph of its new encoder; it says what it does not know."""

import os
import signal
from pathlib import Path

import msgspec
import pytest
import torch

from gri import checkpoint
from gri.core.graph import pairs
from gri.core.trajectory import Trajectory
from gri.errors import InputError
from gri.networks.rollout import rollout
from gri.relations.reaction_scenes import ReactionPrior, draw_reactions
from gri.training.relations.teach_checkpoint import teach_model, teaching_identity
from gri.training.relations.teach_encoder import TeachingSettings
from gri.training.training_state import TrainingState

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


class StopAt:
    """A `Progress` that stops the teaching during the update before its `left`-th report of an update."""

    def __init__(self, left: int) -> None:
        self.left = left

    def __call__(self, stage: str, done: int, total: int, value: float) -> None:
        self.left -= stage != "scenes"
        if self.left == 0:
            os.kill(os.getpid(), signal.SIGINT)


SHORT = msgspec.structs.replace(TINY, updates=7, policy_updates=5)


@pytest.fixture
def fewer_scenes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only how many roll-outs and scenes of novelty there are makes a teaching of few updates long."""
    monkeypatch.setattr("gri.training.relations.teach_checkpoint.ROLLOUTS", 500)
    monkeypatch.setattr("gri.training.relations.teach_checkpoint.NOVELTY_SCENES", 400)


@pytest.mark.usefixtures("fewer_scenes")
def test_a_teaching_that_is_stopped_again_and_again_ends_with_the_same_bytes(
    generator: torch.Generator, tmp_path: Path
):
    model, known = checkpoint.load("us101_car_following"), known_states(generator)
    expected, _ = teach_model(model, known, SHORT, 1)
    path, stages = tmp_path / "taught.state", []
    while True:
        torch.randn(7)  # what this process drew before does not matter
        state = TrainingState(path, teaching_identity(model, known, SHORT, 1))
        stages.append(state.at)
        try:
            with state.stoppable():
                found, made = teach_model(model, known, SHORT, 1, progress=StopAt(3), state=state)
        except KeyboardInterrupt:
            assert len(stages) < 10, "the teaching does not get on"
            continue
        break
    assert stages == [
        "",
        "update 3 of 7 of stage 1 (relations)",
        "update 6 of 7 of stage 1 (relations)",
        "update 2 of 5 of stage 2 (policy's reactions)",
        "update 5 of 5 of stage 2 (policy's reactions)",
    ]
    assert made["cpu_seconds"] >= round(state.spent[1])
    first, second = expected.state_dict(), found.state_dict()
    assert first.keys() == second.keys()
    for name, tensor in first.items():
        assert tensor.numpy().tobytes() == second[name].numpy().tobytes(), name


def test_the_state_of_another_teaching_is_refused(generator: torch.Generator, tmp_path: Path):
    model, known = checkpoint.load("us101_car_following"), known_states(generator)
    other = checkpoint.load("sumo_car_following")
    path = tmp_path / "taught.state"
    mine = teaching_identity(model, known, SHORT, 1)
    state = TrainingState(path, mine)
    with pytest.raises(KeyboardInterrupt), state.stoppable():
        teach_model(model, known, SHORT, 1, progress=StopAt(1), state=state)
    assert TrainingState(path, mine).at
    for identity in (
        teaching_identity(other, known, SHORT, 1),
        teaching_identity(model, known[1:], SHORT, 1),
        teaching_identity(model, known, TINY, 1),
        teaching_identity(model, known, SHORT, 2),
    ):
        with pytest.raises(InputError, match="got the state of a training with another configuration"):
            TrainingState(path, identity)
