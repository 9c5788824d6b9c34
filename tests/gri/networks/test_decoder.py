import pytest
import torch
from torch import Tensor
from torch.nn.functional import silu

from gri.core.graph import FOLLOWING, LANE_CHANGING, EdgeType, InteractionGraph, pairs
from gri.core.scale import CAR_FOLLOWING_US101
from gri.networks.decoder import Decoder, DecoderConfig, FeedForward, dense


def decoder(kind: str = "feed_forward", none_is_silent: bool = True, types: int = 2) -> Decoder:
    torch.manual_seed(1)
    config = DecoderConfig(kind=kind, hidden=16, none_is_silent=none_is_silent)  # type: ignore[arg-type]
    return Decoder(config, CAR_FOLLOWING_US101, types)


def act(policy: Decoder, state: Tensor, graph: Tensor) -> Tensor:
    memory = torch.linspace(-1, 1, 3 * policy.memory_size).reshape(1, 3, -1).expand(len(state), -1, -1)
    return policy.bind(dense(graph))(state, memory * 0)[0]


def random_graph(generator: torch.Generator, scenes: int = 5, types: int = 2) -> Tensor:
    drawn = torch.randint(0, types, (scenes, 6), generator=generator)
    return torch.nn.functional.one_hot(drawn, types).float()


def random_state(generator: torch.Generator, scenes: int = 5) -> Tensor:
    scale = torch.tensor([20.0, 5.0, 1.0])
    return scale * torch.randn(scenes, 3, 3, generator=generator)


FORMS = [("feed_forward", True), ("feed_forward", False), ("recurrent", True), ("recurrent", False)]


def test_dense_graph_puts_edges_at_sender_and_receiver():
    graph = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW}, FOLLOWING).one_hot
    matrix = dense(graph)
    assert matrix[0, 1, 0].tolist() == [0.0, 1.0]
    assert matrix[0, 0, 1].tolist() == [1.0, 0.0]
    assert matrix[0].diagonal(dim1=0, dim2=1).abs().sum() == 0


@pytest.mark.parametrize(("kind", "silent"), FORMS)
def test_renumbering_the_vehicles_renumbers_the_actions(kind: str, silent: bool, generator: torch.Generator):
    policy, state, graph, order = (
        decoder(kind, silent),
        random_state(generator),
        random_graph(generator),
        [1, 2, 0],
    )
    edges = [pairs(3).index((order[i], order[j])) for i, j in pairs(3)]
    renumbered = act(policy, state[:, order], graph[:, edges])
    torch.testing.assert_close(renumbered, act(policy, state, graph)[:, order])


@pytest.mark.parametrize(("kind", "silent"), FORMS)
def test_moving_the_scene_along_the_road_changes_nothing(kind: str, silent: bool, generator: torch.Generator):
    policy, state, graph = decoder(kind, silent), random_state(generator), random_graph(generator)
    moved = state + torch.tensor([200.0, 0.0, 0.0])
    torch.testing.assert_close(act(policy, moved, graph), act(policy, state, graph), atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("kind", ["feed_forward", "recurrent"])
def test_over_an_edge_of_type_none_nothing_is_seen(kind: str, generator: torch.Generator):
    policy, state = decoder(kind), random_state(generator)
    graph = InteractionGraph.of_edges({(2, 1): EdgeType.FOLLOW}, FOLLOWING, batch=5).one_hot
    other = state.clone()
    other[:, 2] += 1.0
    before, after = act(policy, state, graph), act(policy, other, graph)
    torch.testing.assert_close(after[:, 0], before[:, 0])
    assert (after[:, 1] - before[:, 1]).abs().max() > 1e-6


def test_the_literal_form_sees_neighbours_over_edges_of_type_none(generator: torch.Generator):
    policy, state = decoder(none_is_silent=False), random_state(generator)
    graph = InteractionGraph.of_edges({}, FOLLOWING, batch=5).one_hot
    other = state.clone()
    other[:, 2, 1] += 1.0
    assert (act(policy, other, graph) - act(policy, state, graph))[:, 0].abs().max() > 1e-5


@pytest.mark.parametrize("silent", [True, False])
def test_fused_layers_equal_one_network_per_type(silent: bool, generator: torch.Generator):
    """Equations (policy1)-(policy3), written as loops over vehicles and types."""
    types = len(LANE_CHANGING)
    policy = decoder(none_is_silent=silent, types=types)
    state, graph = random_state(generator), random_graph(generator, types=types)
    body = policy.body
    assert isinstance(body, FeedForward)
    scaled = (state - policy.offset) / policy.unit
    sender, receiver = body.messages.first_layer()
    hidden, first = body.messages.hidden, body.messages.first_type
    actions = []
    for j in range(3):
        total = torch.zeros(len(state), hidden)
        for edge, (i, to) in enumerate(pairs(3)):
            if to != j:
                continue
            for k in range(first, types):
                rows = slice((k - first) * hidden, (k - first + 1) * hidden)
                inner = scaled[:, i] @ sender[rows].T + scaled[:, j] @ receiver[rows].T
                inner = silu(inner + body.messages.sender.bias[rows])
                message = silu(inner @ body.messages.second.weight[:, rows].T + body.messages.second_bias[k - first])
                total = total + graph[:, edge, k : k + 1] * message
        start = body.node[0](total)
        if body.own is not None:
            start = start + body.own(scaled[:, j, 1:])
        actions.append(body.node[1:](start) * policy.action_unit)
    torch.testing.assert_close(act(policy, state, graph), torch.stack(actions, 1))


def test_only_driven_vehicles_get_actions(generator: torch.Generator):
    policy, state, graph = decoder(), random_state(generator), random_graph(generator)
    driven, _ = policy.bind(dense(graph)[:, :, :2])(state, torch.zeros(5, 2, 0))
    torch.testing.assert_close(driven, act(policy, state, graph)[:, :2])


def test_detached_senders_get_no_gradient(generator: torch.Generator):
    policy = decoder()
    state = random_state(generator).requires_grad_()
    graph = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW}, FOLLOWING, batch=5).one_hot
    action, _ = policy.bind(dense(graph), detach_senders=True)(state, torch.zeros(5, 3, 0))
    (gradient,) = torch.autograd.grad(action[:, 0].sum(), state)
    assert gradient[:, 1].abs().max() == 0
    assert gradient[:, 0].abs().max() > 0
