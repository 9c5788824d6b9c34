"""A training that is stopped and goes on ends as one that is not stopped, for every objective."""

import os
import signal
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
import torch
from safetensors.torch import load_file

from gri.data.store import DataConfig, Splits, scenes_of
from gri.errors import InputError
from gri.networks.decoder import DecoderConfig
from gri.networks.encoder import EncoderConfig
from gri.training.adversarial.airl import AdversarialSettings, PlannedStart
from gri.training.baselines.nri import NriSettings
from gri.training.baselines.supervised import SupervisedSettings
from gri.training.grounded.labelled_encoder import LabelledEncoderSettings
from gri.training.grounded.optimal_scenes import OptimaSettings
from gri.training.grounded.planned_start import PlanSettings
from gri.training.grounded.settings import GroundedSettings
from gri.training.optimisation import Bottleneck, Descent
from gri.training.train import Objective, TrainConfig, Trained, train
from gri.training.training_state import TrainingState, identity
from tests.fuzz.other_inputs import good_state, read_state

DATA = DataConfig(range="paper", graphs="one", train=12, validation=2, test=2, expert_updates=1)
GROUNDED = GroundedSettings(
    updates=3, batch=4, return_batch=2, reward_updates=3, reward_batch=4, encoder_lead=2, graph_scenes=8
)
PLAN = PlanSettings(
    updates=2, batch=2, imitation_updates=2, imitation_batch=2, optima=OptimaSettings(scenes=4, sweeps=1)
)
SUMMED = Bottleneck(form="accumulating")  # β depends on all updates before
OBJECTIVES: dict[str, Objective] = {
    "supervised": SupervisedSettings(updates=4, batch=4),
    "nri": NriSettings(updates=4, batch=4, bottleneck=SUMMED),
    "grounded": GROUNDED,
    "labelled": LabelledEncoderSettings(grounded=GROUNDED),
    "adversarial": AdversarialSettings(
        updates=3, batch=4, reward_updates=2, bottleneck=SUMMED, start=PlannedStart(plan=PLAN, encoder_updates=2)
    ),
}


def config(objective: Objective) -> TrainConfig:
    small = {"decoder": DecoderConfig(hidden=8), "encoder": EncoderConfig(hidden=8, heads=2)}
    return TrainConfig(name="small", data=DATA, objective=objective, **small)


@pytest.fixture(scope="module")
def splits(tmp_path_factory: pytest.TempPathFactory) -> Splits:
    return scenes_of(DATA, tmp_path_factory.mktemp("scenes"))


class StopAt:
    """A `Progress` that stops the training once, during the update before its `number`-th report."""

    def __init__(self, number: int) -> None:
        self.left = number

    def __call__(self, stage: str, done: int, total: int, value: float) -> None:
        self.left -= 1
        if self.left == 0:
            os.kill(os.getpid(), signal.SIGINT)


def weights(trained: Trained) -> dict[str, bytes]:
    tensors = dict(trained.model.state_dict())
    if trained.reward is not None:
        tensors |= {f"reward.{name}": value for name, value in trained.reward.state_dict().items()}
    return {name: value.numpy().tobytes() for name, value in tensors.items()}


def resumed(objective: Objective, splits: Splits, path: Path, stop: Callable[[int], StopAt]) -> tuple[Trained, int]:
    """A training that is stopped after every second report, and how often it was stopped."""
    stops = 0
    while True:
        state = TrainingState(path, identity(config(objective), 0, splits.train))
        try:
            with state.stoppable():
                return train(config(objective), splits, 0, stop(2), state), stops
        except KeyboardInterrupt:
            stops += 1
            assert path.exists()
            assert stops < 60, "the training does not get on"


@pytest.mark.parametrize("name", OBJECTIVES)
def test_a_training_that_is_stopped_again_and_again_ends_with_the_same_bytes(
    name: str, splits: Splits, tmp_path: Path
) -> None:
    expected = train(config(OBJECTIVES[name]), splits, 0)
    torch.randn(7)  # what this process drew before does not matter
    found, stops = resumed(OBJECTIVES[name], splits, tmp_path / "small.state", StopAt)
    assert stops >= 1
    assert weights(found) == weights(expected)


def test_the_state_of_another_training_is_refused(splits: Splits, tmp_path: Path) -> None:
    path = tmp_path / "small.state"
    one = config(SupervisedSettings(updates=4, batch=4))
    state = TrainingState(path, identity(one, 0, splits.train))
    with pytest.raises(KeyboardInterrupt), state.stoppable():
        train(one, splits, 0, StopAt(2), state)
    assert TrainingState(path, identity(one, 0, splits.train)).at == "update 2 of 4 of stage 1 (policy)"
    other = msgspec.structs.replace(one, objective=SupervisedSettings(updates=5, batch=4))
    for text in (identity(one, 1, splits.train), identity(other, 0, splits.train), identity(one, 0, splits.test)):
        with pytest.raises(InputError, match="with another configuration, seed, scenes or version"):
            TrainingState(path, text)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match="remove it to begin anew"):
        TrainingState(path, identity(one, 0, splits.train))


def test_a_descent_goes_on_with_its_moments_and_its_schedule() -> None:
    def descents() -> tuple[torch.nn.Parameter, Descent]:
        parameter = torch.nn.Parameter(torch.tensor([2.0, -1.0]))
        return parameter, Descent([parameter], 0.1, 10)

    def step(parameter: torch.nn.Parameter, descent: Descent) -> None:
        descent.step((parameter**2).sum())

    whole, straight = descents()
    for _ in range(4):
        step(whole, straight)
    first, begun = descents()
    for _ in range(2):
        step(first, begun)
    second, continued = descents()
    continued.restore(*begun.state())
    for _ in range(2):
        step(second, continued)
    assert second.tolist() == whole.tolist()
    forgetful, anew = descents()  # with the parameters alone it would be somewhere else
    tensors, numbers = begun.state()
    with torch.no_grad():
        forgetful.copy_(tensors["parameter.0"])
    for _ in range(2):
        step(forgetful, anew)
    assert forgetful.tolist() != whole.tolist()
    assert numbers["rate"] < 0.1


def test_nothing_is_written_without_a_place(tmp_path: Path, splits: Splits, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    train(config(SupervisedSettings(updates=1, batch=2)), splits, 0)
    assert not [*tmp_path.iterdir()]
    state = TrainingState(tmp_path / "a.state", "x")
    train(config(SupervisedSettings(updates=1, batch=2)), splits, 0, state=state)
    state.save()
    assert "0.0.parameter.0" in load_file(tmp_path / "a.state")
    state.finish()
    assert not [*tmp_path.iterdir()]


def test_a_flipped_bit_in_a_state_is_refused(tmp_path: Path):
    """It would go on with another number otherwise. The last digit of a decimal number need not change its value."""
    (content,) = good_state()
    path, refused = tmp_path / "state", 0
    path.write_bytes(content)
    wanted = [parameter.tolist() for parameter in read_state(path)[:-1]]
    bits = range(0, 8 * len(content), 401)
    for bit in bits:
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        try:
            assert [parameter.tolist() for parameter in read_state(path)[:-1]] == wanted
        except InputError:
            refused += 1
    assert refused > 0.98 * len(bits)
