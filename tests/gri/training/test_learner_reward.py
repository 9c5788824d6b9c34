"""The learner's reward and the expert's: what they share, and what the learner is told."""

from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from gri.data import store
from gri.data.ranges.car_following import PAPER
from gri.data.store import DataConfig
from gri.data.synthetic.expert import true_reward
from gri.errors import InputError
from gri.paper.rows import SCENARIOS, config_of
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.structured import AssumedReward, StructuredReward
from gri.training.grounded.settings import GroundedSettings
from gri.training.train import TrainConfig, learner_reward, read_train_config

DATA = DataConfig(range="paper", graphs="one")
ASSUMED = AssumedReward(constants=FollowingConstants(time_headway=1.6))


def config(reward: AssumedReward | msgspec.UnsetType = msgspec.UNSET) -> TrainConfig:
    return TrainConfig(name="x", data=DATA, objective=GroundedSettings(), reward=reward)


def objects(value: object) -> Iterator[object]:
    """The structs inside a configuration, itself included."""
    if isinstance(value, msgspec.Struct):
        yield value
        for name in value.__struct_fields__:
            yield from objects(getattr(value, name))


@pytest.mark.parametrize("reward", [msgspec.UNSET, ASSUMED], ids=["told", "assumed"])
def test_learner_and_expert_share_no_object(reward: AssumedReward | msgspec.UnsetType):
    chosen = config(reward)
    learner, expert = learner_reward(chosen), DATA.scene_range.reward
    assert not {id(each) for each in objects(learner)} & {id(each) for each in objects(expert)}
    made, true = StructuredReward(learner), true_reward(DATA.scene_range)
    assert not {id(each) for each in objects(made.config)} & {id(each) for each in objects(true.config)}
    assert not {p.data_ptr() for p in made.parameters()} & {p.data_ptr() for p in true.parameters()}


def test_every_row_of_the_paper_has_a_reward_of_its_own():
    configs = [config_of(s, row) for s in SCENARIOS for row in s.rows if not row.calibrated]
    for each in configs:
        if each is not None:
            given = (each.data.recorded or each.data.scene_range).reward
            assert not {id(e) for e in objects(learner_reward(each))} & {id(e) for e in objects(given)}


def test_a_learner_that_is_told_nothing_else_has_the_expert_s_values():
    assert learner_reward(config()) == PAPER.reward


def test_what_is_assumed_does_not_change_with_the_expert(monkeypatch: pytest.MonkeyPatch):
    constants = msgspec.structs.replace(PAPER.reward.constants, time_headway=3.3, speed_limit=99.0)
    reward = msgspec.structs.replace(PAPER.reward, constants=constants, temperature=7.0)
    monkeypatch.setitem(store._SYNTHETIC, "paper", msgspec.structs.replace(PAPER, reward=reward))
    assert learner_reward(config(ASSUMED)) == ASSUMED
    assert learner_reward(config()) == reward


def test_the_configuration_of_a_learner_is_read_from_yaml(tmp_path: Path):
    path = tmp_path / "wrong.yaml"
    path.write_text(
        "name: wrong\ndata: {range: paper, graphs: one}\nobjective: {type: gri}\n"
        "reward: {type: assumed, constants: {time_headway: 1.6}, learn: false}\n"
    )
    assert read_train_config(path).reward == msgspec.structs.replace(ASSUMED, learn=False)


def test_configurations_without_the_field_are_written_as_before():
    assert "reward" not in msgspec.to_builtins(config())
    assert "expert" not in msgspec.to_builtins(DATA)
    assert "constants" not in msgspec.to_builtins(GroundedSettings())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "data: {range: lane_changing, graphs: one}\nobjective: {type: gri}\nreward: {type: assumed}\n",
            "field reward: got it for range lane_changing, wanted one of paper, us101",
        ),
        (
            "data: {range: paper, graphs: one}\nobjective: {type: nri, structured_prior: true}\n",
            r"field objective\.structured_prior: got it for range paper, wanted scenes of recorded traffic",
        ),
    ],
)
def test_fields_that_would_have_no_effect_are_refused(tmp_path: Path, content: str, message: str):
    path = tmp_path / "own.yaml"
    path.write_text(f"name: own\n{content}")
    with pytest.raises(InputError, match=message):
        read_train_config(path)
