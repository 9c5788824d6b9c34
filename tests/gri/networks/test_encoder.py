import msgspec
import pytest
import torch

from gri.core.graph import pairs
from gri.core.scale import CAR_FOLLOWING_US101
from gri.networks.encoder import Encoder, EncoderConfig, pair_series


@pytest.fixture(params=[False, True], ids=["paper", "skip"])
def encoder(request: pytest.FixtureRequest) -> Encoder:
    torch.manual_seed(0)
    return Encoder(EncoderConfig(hidden=16, skip=request.param), CAR_FOLLOWING_US101, 2, 0.2)


def trajectories(generator: torch.Generator, scenes: int = 4, vehicles: int = 3, steps: int = 20) -> torch.Tensor:
    return 10 * torch.randn(scenes, vehicles, steps, 3, generator=generator)


@pytest.mark.parametrize("steps", [1, 2, 7, 20, 45])
@pytest.mark.parametrize("vehicles", [2, 3, 5])
def test_any_number_of_instants_and_vehicles(encoder: Encoder, generator: torch.Generator, steps: int, vehicles: int):
    logits = encoder(trajectories(generator, vehicles=vehicles, steps=steps))
    assert logits.shape == (4, len(pairs(vehicles)), 2)
    assert torch.isfinite(logits).all()


def test_renumbering_the_vehicles_renumbers_the_edges(encoder: Encoder, generator: torch.Generator):
    state, order = trajectories(generator), [2, 0, 1]
    logits, renumbered = encoder(state), encoder(state[:, order])
    for edge, (i, j) in enumerate(pairs(3)):
        torch.testing.assert_close(renumbered[:, edge], logits[:, pairs(3).index((order[i], order[j]))])


def test_moving_the_scene_along_the_road_changes_nothing(encoder: Encoder, generator: torch.Generator):
    state = trajectories(generator)
    moved = state + torch.tensor([300.0, 0.0, 0.0])
    torch.testing.assert_close(encoder(moved), encoder(state), atol=1e-4, rtol=1e-4)


def test_double_precision_gives_the_same_logits(encoder: Encoder, generator: torch.Generator):
    state = trajectories(generator)
    logits = encoder(state)
    in_double = encoder.double()(state.double())
    assert in_double.dtype == torch.float64
    torch.testing.assert_close(in_double.float(), logits, atol=1e-4, rtol=1e-4)


def test_accelerations_are_not_read_by_default(encoder: Encoder, generator: torch.Generator):
    state = trajectories(generator)
    other = state + torch.tensor([0.0, 0.0, 5.0])
    assert torch.equal(encoder(state), encoder(other))


def test_scenes_do_not_see_each_other(encoder: Encoder, generator: torch.Generator):
    state = trajectories(generator)
    torch.testing.assert_close(encoder(state)[1:2], encoder(state[1:2]))


@pytest.fixture
def of_pairs() -> Encoder:
    torch.manual_seed(0)
    return Encoder(EncoderConfig(hidden=16, reads=(0, 1, 2), pair_series=True), CAR_FOLLOWING_US101, 4, 0.2)


def test_an_encoder_of_pairs_knows_no_numbers_no_places_and_no_other_scenes(
    of_pairs: Encoder, generator: torch.Generator
):
    state, order = trajectories(generator, steps=of_pairs.least_steps), [2, 0, 1]
    logits, renumbered = of_pairs(state), of_pairs(state[:, order])
    for edge, (i, j) in enumerate(pairs(3)):
        torch.testing.assert_close(renumbered[:, edge], logits[:, pairs(3).index((order[i], order[j]))])
    moved = state + torch.tensor([300.0, 0.0, 0.0])
    torch.testing.assert_close(of_pairs(moved), logits, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(logits[1:2], of_pairs(state[1:2]))


def test_series_of_a_pair_by_hand():
    """Vehicle 0 is 20 m ahead of vehicle 1, 1 m to its left, moves 1 cm left per step, and 1 brakes at 1 m/s²."""
    time = torch.arange(6.0)
    ahead = torch.stack([20 + time, 1 + 0.01 * time, torch.full((6,), 5.0)], -1)
    behind = torch.stack([time, 0 * time, 6 - 0.2 * time], -1)
    series = pair_series(torch.stack([ahead, behind])[None], 0.2)[0, pairs(2).index((0, 1))]
    gap, difference, slower = 15.0, 5.0 - 5.0, 5.0
    wanted = [20 / 20, gap / 5, gap / (slower + 2) / 2, difference / 3, 1.05 / 3.6, 0.1, 0.0, 0.5, 0.0, 0.0, -0.5]
    wanted = torch.tensor([v if k not in (1, 2, 5, 7) else float(torch.tensor(v).tanh()) for k, v in enumerate(wanted)])
    torch.testing.assert_close(series[-1], wanted, atol=1e-4, rtol=0)


def test_files_of_encoders_without_series_say_nothing_of_them():
    """So checkpoints and hashes of configurations stay as they were."""
    assert "pair_series" not in msgspec.to_builtins(EncoderConfig())
