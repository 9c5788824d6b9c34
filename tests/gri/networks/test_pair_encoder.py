"""The pair encoder: structure of its answers, invariances, and the score of novelty."""

import pytest
import torch

from gri.core.graph import pairs
from gri.networks.model import ModelConfig, RelationalModel
from gri.networks.novelty import Novelty
from gri.networks.pair_encoder import PairEncoder, PairEncoderConfig, Pairs, pair_motion


@pytest.fixture
def encoder() -> PairEncoder:
    torch.manual_seed(0)
    return PairEncoder(PairEncoderConfig(hidden=16), 1, 0.2).double()


def rows(generator: torch.Generator, scenes: int = 4, vehicles: int = 3, steps: int = 25) -> torch.Tensor:
    """Vehicles in a row, the last one ahead, with wandering speeds."""
    v = 15 + 0.3 * torch.randn(scenes, vehicles, steps, generator=generator, dtype=torch.float64).cumsum(-1)
    start = 25.0 * torch.arange(vehicles) + 5 * torch.rand(scenes, vehicles, generator=generator)
    x = start[..., None] + 0.2 * v.cumsum(-1)
    return torch.stack([x, v, torch.zeros_like(x)], -1)


@pytest.mark.parametrize(("vehicles", "steps"), [(2, 14), (3, 25), (5, 61), (8, 30)])
def test_any_number_of_vehicles_and_instants(
    encoder: PairEncoder, generator: torch.Generator, vehicles: int, steps: int
):
    logits = encoder(rows(generator, vehicles=vehicles, steps=steps))
    assert logits.shape == (4, len(pairs(vehicles)), 2)
    torch.testing.assert_close(logits.exp().sum(-1), torch.ones_like(logits[..., 0]))


def test_a_vehicle_follows_at_most_one_and_only_one_ahead(encoder: PairEncoder, generator: torch.Generator):
    follow = encoder(rows(generator)).detach().exp()[..., 1]
    for edge, (i, j) in enumerate(pairs(3)):
        assert i > j or float(follow[:, edge].max()) < 1e-12
    into_0 = follow[:, pairs(3).index((1, 0))] + follow[:, pairs(3).index((2, 0))]
    assert float(into_0.max()) < 1.0
    assert torch.equal(encoder.explanations(rows(generator)).sum(-1).round(decimals=9), torch.ones(4, 3).double())


def test_renumbering_the_vehicles_renumbers_the_edges(encoder: PairEncoder, generator: torch.Generator):
    state, order = rows(generator), [2, 0, 1]
    logits, renumbered = encoder(state), encoder(state[:, order])
    for edge, (i, j) in enumerate(pairs(3)):
        torch.testing.assert_close(renumbered[:, edge], logits[:, pairs(3).index((order[i], order[j]))])


def test_moving_the_scene_along_the_road_changes_nothing(encoder: PairEncoder, generator: torch.Generator):
    state = rows(generator)
    torch.testing.assert_close(encoder(state + torch.tensor([5e3, 0.0, 0.0])), encoder(state))


def test_vehicles_behind_do_not_change_what_a_vehicle_reacts_to(encoder: PairEncoder, generator: torch.Generator):
    state = rows(generator, vehicles=4)
    whole, part = encoder.explanations(state), encoder.explanations(state[:, 1:])
    torch.testing.assert_close(whole[:, 1:, 3:], part[..., 2:])


def test_motion_of_a_pair_by_hand():
    x = torch.tensor([[[0.0, 2.0, 4.0, 6.0], [30.0, 33.0, 36.0, 39.0]]])
    v = torch.tensor([[[10.0, 10.0, 10.0, 10.0], [14.0, 15.0, 16.0, 17.0]]])
    motion = pair_motion(x, v, Pairs(torch.tensor([0]), torch.tensor([0]), torch.tensor([1])), 0.2)
    assert motion.gap.tolist() == [[25.0, 26.0, 27.0, 28.0]]
    torch.testing.assert_close(motion.sender_a, torch.full((1, 4), 5.0))
    torch.testing.assert_close(motion.receiver_a, torch.zeros(1, 4))


def test_novelty_knows_scenes_like_those_it_was_fitted_to_and_no_others(generator: torch.Generator):
    novelty = Novelty(200, 1, 0.2).double()
    state = rows(generator, scenes=400)
    assert float(novelty(state).max()) == 0.0
    novelty.fit(state[:300], generator)
    assert float((novelty(state[300:]) > 1).double().mean()) < 0.06
    faster, farther, wrong_time = state.clone(), state.clone(), state.clone()
    faster[..., 1] += 20
    faster[..., 0] += 20 * 0.2 * torch.arange(25)
    farther[:, 1:, :, 0] += 300
    wrong_time[..., 0] *= 2
    for strange in (faster, farther, wrong_time):
        assert float((novelty(strange) > 1).double().mean()) > 0.95


def test_the_graph_carries_the_score(generator: torch.Generator):
    model = RelationalModel(ModelConfig(encoder=None, pair_encoder=PairEncoderConfig(hidden=16)))
    graph = model.infer(rows(generator).float())
    assert graph.unknown is not None
    assert graph[:2].unknown.shape == (2,)
