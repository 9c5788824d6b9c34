"""Contrastive teaching on recordings: what is varied stays a motion, and a follower is told from a stranger."""

import os
import signal
from pathlib import Path

import msgspec
import pytest
import torch

from gri import checkpoint
from gri.bench.scores import auc
from gri.core.graph import pairs
from gri.errors import InputError
from gri.networks.pair_encoder import PairEncoder, PairEncoderConfig
from gri.relations.reaction_scenes import UNSEEN, Reactions
from gri.training.relations import teach_recorded
from gri.training.relations.recorded_windows import ContrastSettings, Variation, WeightedWindows
from gri.training.relations.teach_recorded import (
    recorded_teaching_identity,
    teach_recorded_encoder,
    teach_recorded_model,
    varied,
)
from gri.training.training_state import TrainingState

DT = 0.2
TINY = ContrastSettings(
    encoder=PairEncoderConfig(hidden=8, reads="motion", members=2), steps=(31,), shares=(1.0,), updates=6, batch=16
)


def waves(scenes: int, vehicles: int, follows: bool, seed: int, steps: int = 31) -> Reactions:
    """Each vehicle repeats the speed of the one ahead 0.8 s later, or has a wave of its own."""
    generator = torch.Generator().manual_seed(seed)
    time = DT * torch.arange(steps) - 0.8 * (vehicles - 1 - torch.arange(vehicles))[:, None]
    shape = (scenes, 1 if follows else vehicles, 1)
    rate, phase = 0.5 + torch.rand(shape, generator=generator), 6.3 * torch.rand(shape, generator=generator)
    v = 8 + 2 * torch.cos(rate * time + phase)
    x = 20.0 * torch.arange(vehicles)[:, None] + 8 * DT * torch.arange(steps)
    x = x + 2 / rate * (torch.sin(rate * time + phase) - torch.sin(rate * time[:, :1] + phase))
    leader = torch.tensor([*range(1, vehicles), UNSEEN]) if follows else torch.full((vehicles,), UNSEEN)
    return Reactions(x, v, leader.expand(scenes, vehicles))


def groups(scenes: int = 200) -> list[list[WeightedWindows]]:
    found = []
    for vehicles in (2, 3):
        recorded, broken = (waves(scenes, vehicles, follows, vehicles) for follows in (True, False))
        both = Reactions(*(torch.cat([getattr(w, name) for w in (recorded, broken)]) for name in ("x", "v", "leader")))
        found.append([WeightedWindows(both, torch.ones(2 * scenes), 1.0)])
    return found


def test_varied_windows_are_motions_with_the_same_relations(generator: torch.Generator):
    known = waves(50, 3, True, 1)
    how = Variation(noise=(1e-6, 2e-6))
    made = varied(known, how, DT, generator)
    assert torch.equal(made.leader, known.leader)
    way = ((made.v[..., 1:] + made.v[..., :-1]) / 2 * DT).cumsum(-1)
    torch.testing.assert_close(made.x[..., 1:] - made.x[..., :1], way, atol=0.05, rtol=0)
    assert float((made.x[:, 1:] - made.x[:, :-1]).min()) > 5
    fluctuation, before = (v - v.mean((1, 2), keepdim=True) for v in (made.v, known.v))
    factor = (fluctuation * before).sum((1, 2)) / before.square().sum((1, 2))
    torch.testing.assert_close(fluctuation, factor[:, None, None] * before, atol=1e-3, rtol=0)
    assert float(factor.min()) < -0.5
    assert float(factor.max()) > 1.2
    assert float((made.v.mean((1, 2)) - known.v.mean((1, 2))).max()) > 5


def test_windows_that_would_drive_backwards_stay_as_they_are(generator: torch.Generator):
    known = waves(20, 2, True, 1)
    slow = Reactions(known.x, known.v - known.v.amin((1, 2), keepdim=True), known.leader)
    made = varied(slow, Variation(faster=0.0, scale=(5.0, 6.0), mirrored=1.0), DT, generator)
    assert torch.equal(made.v, slow.v)


def test_followers_are_told_from_strangers_and_from_nothing_where_there_is_nothing():
    settings = msgspec.structs.replace(TINY, updates=60, batch=32)
    encoder = PairEncoder(settings.encoder, 1, DT)
    teach_recorded_encoder(encoder, groups(), settings, 0)

    def ranked(follows: bool) -> float:
        tested = [waves(200, 2, follows, 50), waves(200, 2, False, 51)]
        with torch.no_grad():
            p = torch.cat([encoder.explanations(torch.stack([w.x, w.v], -1))[:, 0, 3] for w in tested])
        truth = torch.arange(400) < 200
        return auc(p.double().numpy()[:, None], truth.numpy()[:, None])

    assert ranked(True) > 0.85
    assert 0.4 < ranked(False) < 0.6


def test_reward_and_policy_stay_and_the_file_holds_all_members(monkeypatch, generator: torch.Generator, tmp_path: Path):
    monkeypatch.setattr(teach_recorded, "NOVELTY_WINDOWS", 400)
    model = checkpoint.load("ngsim_car_following")
    taught, made = teach_recorded_model(model, groups(40), TINY, 3)
    assert made["settings"]["encoder"]["members"] == 2
    assert made["recorded_windows"] == 80
    checkpoint.save(tmp_path / "taught.safetensors", taught, None, {"teaching": made})
    loaded = checkpoint.load(tmp_path / "taught.safetensors")
    seen = waves(5, 3, True, 9)
    state = torch.stack([seen.x, seen.v, torch.zeros_like(seen.x)], -1)
    graph = loaded.infer(state)
    assert torch.equal(graph.logits, taught.infer(state).logits)
    assert graph.logits.shape == (5, len(pairs(3)), 2)
    assert graph.unknown is not None
    for name, tensor in model.decoder.state_dict().items():
        assert torch.equal(tensor, loaded.decoder.state_dict()[name]), name
    sparse = loaded.infer(state, tuple(pairs(3)))
    torch.testing.assert_close(sparse.probs, graph.probs, atol=1e-5, rtol=0)


def test_members_are_averaged_and_differ():
    encoder = PairEncoder(TINY.encoder, 1, DT)
    teach_recorded_encoder(encoder, groups(40), TINY, 0)
    seen = waves(5, 3, True, 9)
    state = torch.stack([seen.x, seen.v], -1)
    with torch.no_grad():
        alone = [member.own_scores(state).log_softmax(-1) for member in encoder.members]
        together = encoder.scores(state)
    assert len(alone) == 2
    assert not torch.allclose(alone[0], alone[1])
    torch.testing.assert_close(together, (alone[0] + alone[1]) / 2)


class StopAt:
    """A `Progress` that stops the teaching during the update before its `left`-th report."""

    def __init__(self, left: int) -> None:
        self.left = left

    def __call__(self, stage: str, done: int, total: int, value: float) -> None:
        self.left -= 1
        if self.left == 0:
            os.kill(os.getpid(), signal.SIGINT)


def test_a_teaching_that_is_stopped_ends_with_the_same_bytes(monkeypatch, tmp_path: Path):
    monkeypatch.setattr(teach_recorded, "NOVELTY_WINDOWS", 400)
    model, known, path = checkpoint.load("ngsim_car_following"), groups(40), tmp_path / "taught.state"
    expected, _ = teach_recorded_model(model, known, TINY, 1)
    stages = []
    while True:
        torch.randn(7)  # what this process drew before does not matter
        state = TrainingState(path, recorded_teaching_identity(model, known, TINY, 1))
        stages.append(state.at)
        try:
            with state.stoppable():
                found, _ = teach_recorded_model(model, known, TINY, 1, StopAt(4), state)
        except KeyboardInterrupt:
            assert len(stages) < 10, "the teaching does not get on"
            continue
        break
    assert stages == [
        "",
        "update 4 of 6 of stage 1 (member 1 of 2)",
        "update 2 of 6 of stage 2 (member 2 of 2)",
        "update 6 of 6 of stage 2 (member 2 of 2)",
    ]
    first, second = expected.state_dict(), found.state_dict()
    for name, tensor in first.items():
        assert tensor.numpy().tobytes() == second[name].numpy().tobytes(), name
    other = recorded_teaching_identity(model, groups(39), TINY, 1)
    assert other != recorded_teaching_identity(model, known, TINY, 1)


def test_models_with_other_edges_are_refused():
    with pytest.raises(InputError, match="wanted none and follow"):
        teach_recorded_model(checkpoint.load("us101_merge"), groups(5), TINY, 0)
