"""The pair encoder on candidate pairs: the complete graph on three is one case, and many vehicles are another."""

import pytest
import torch

import gri
from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph, pairs
from gri.networks import fast_reaction_evidence, reaction_evidence
from gri.networks.fast_pair_encoder import explain_pairs
from gri.networks.pair_encoder import PairEncoder

CHECKPOINTS = ["us101_car_following", "ngsim_relations"]


def rows(generator: torch.Generator, scenes: int, vehicles: int, steps: int = 25) -> torch.Tensor:
    """Vehicles in a row, the last one ahead, with wandering speeds; states x, v, a."""
    v = 15 + 0.3 * torch.randn(scenes, vehicles, steps, generator=generator, dtype=torch.float64).cumsum(-1)
    start = 25.0 * torch.arange(vehicles) + 5 * torch.rand(scenes, vehicles, generator=generator)
    return torch.stack([start[..., None] + 0.2 * v.cumsum(-1), v, torch.zeros_like(v)], -1)


def chain(vehicles: int) -> tuple[tuple[int, int], ...]:
    return tuple((i, j) for i in range(vehicles) for j in (i - 1, i + 1) if 0 <= j < vehicles)


@pytest.mark.parametrize("name", CHECKPOINTS)
def test_complete_graph_is_one_case(name: str, generator: torch.Generator):
    model, state = gri.load(name), rows(generator, 40, 3, 30)
    sparse = model.infer(state.float(), tuple(pairs(3)))
    torch.testing.assert_close(sparse.probs, model.infer(state.float()).probs, atol=1e-5, rtol=0)
    model.double()
    sparse = model.infer(state, tuple(pairs(3)))
    torch.testing.assert_close(sparse.probs, model.infer(state).probs, atol=1e-9, rtol=0)
    assert sparse.edges(3).keys() == model.infer(state).edges(3).keys()


def test_evidence_is_that_of_the_definition(generator: torch.Generator):
    state = rows(generator, 60, 2)
    gap, own, other = state[:, 1, :, 0] - state[:, 0, :, 0] - 5, state[:, 0, :, 1], state[:, 1, :, 1]
    for evidence in (fast_reaction_evidence, reaction_evidence):
        assert torch.isfinite(evidence.reaction_evidence(gap, own, other, 0.2)).all()
    fast, defined = (e.reaction_evidence(gap, own, other, 0.2) for e in (fast_reaction_evidence, reaction_evidence))
    torch.testing.assert_close(fast, defined, atol=1e-7, rtol=1e-9)


def test_explanations_add_up_to_one_and_nobody_reacts_to_a_vehicle_behind(generator: torch.Generator):
    encoder = gri.load("us101_car_following").encoder
    assert isinstance(encoder, PairEncoder)
    state = rows(generator, 1, 30)[0].float()
    candidates = torch.tensor(chain(30))
    null, follow = explain_pairs(encoder, state[..., 0], state[..., 1], candidates)
    total = null.sum(1).index_add(0, candidates[:, 1], follow)
    torch.testing.assert_close(total, torch.ones(30))
    assert float(follow[candidates[:, 0] < candidates[:, 1]].max()) == 0.0
    assert float(follow.max()) > 0.5


def test_vehicles_far_away_change_nothing(generator: torch.Generator):
    """The first eight of many vehicles have the graph that they have alone."""
    model, state = gri.load("us101_car_following"), rows(generator, 1, 600).float()
    many, few = model.infer(state, chain(600)), model.infer(state[:, :8], chain(8))
    for pair in chain(8):
        alone = few.probs[0, few.pairs.index(pair), 1]
        torch.testing.assert_close(many.probs[0, many.pairs.index(pair), 1], alone, atol=2e-5, rtol=0)


def test_no_pairs_and_no_vehicles(generator: torch.Generator):
    model = gri.load("us101_car_following")
    assert model.infer(rows(generator, 2, 1).float(), ()).logits.shape == (2, 0, 2)
    assert model.infer(rows(generator, 2, 2).float(), ((0, 1),)).edges() == {}


def test_other_encoders_refuse_candidate_pairs(generator: torch.Generator):
    with pytest.raises(ValueError, match="without a pair encoder"):
        gri.load("sumo_car_following").infer(rows(generator, 1, 4).float(), chain(4))


@pytest.mark.parametrize("name", CHECKPOINTS)
def test_driving_under_candidate_pairs_is_driving_under_the_complete_graph(name: str, generator: torch.Generator):
    """Both decoders, feed-forward and recurrent, with 5 and with 12 vehicles."""
    model = gri.load(name)
    for n in (5, 12):
        now = rows(generator, 1, n).float()[:, :, -1]
        edges = {(j + 1, j): EdgeType.FOLLOW for j in range(n - 1) if j != 2}
        graphs = [InteractionGraph.of_edges(edges, FOLLOWING, n, candidates=of) for of in (chain(n), None)]
        action = [model.act(gri.PolicyState(graph, model.memory(now)), now)[0] for graph in graphs]
        torch.testing.assert_close(*action, atol=1e-5, rtol=0)
        assert float(action[0].std()) > 0.01


def test_a_policy_infers_candidate_pairs_of_more_than_three_vehicles(generator: torch.Generator):
    """Whatever the order of the vehicles; a model with a given chain drives the whole chain."""
    model, state = gri.load("us101_car_following"), rows(generator, 2, 6).float()
    graph = model.begin(gri.Trajectory.complete(state, 0.2)).graph
    assert graph is not None
    assert graph.pairs == chain(6)
    order = [3, 1, 5, 0, 2, 4]
    shuffled = model.begin(gri.Trajectory.complete(state[:, order], 0.2)).graph
    assert shuffled is not None
    assert {tuple(sorted((order[i], order[j]))) for i, j in shuffled.pairs} == {(j, j + 1) for j in range(5)}
    told = gri.load("us101_car_following_supervised").begin(gri.Trajectory.complete(state, 0.2)).graph
    assert told is not None
    assert set(told.edges()) == {(j + 1, j) for j in range(5)}
    three = model.begin(gri.Trajectory.complete(state[:, :3], 0.2)).graph
    assert three is not None
    assert three.candidates is None
