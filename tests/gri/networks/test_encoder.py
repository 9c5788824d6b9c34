import pytest
import torch

from gri.core.graph import pairs
from gri.core.scale import CAR_FOLLOWING_US101
from gri.networks.encoder import Encoder, EncoderConfig


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
