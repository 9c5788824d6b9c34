import numpy as np
import pytest
import torch
from torch import Tensor

from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph
from gri.core.scale import CAR_FOLLOWING_US101
from gri.networks import fast_decoder
from gri.networks.decoder import Decoder, DecoderConfig, dense


def decoder(kind: str = "feed_forward", none_is_silent: bool = True, types: int = 2) -> Decoder:
    torch.manual_seed(1)
    config = DecoderConfig(kind=kind, hidden=16, none_is_silent=none_is_silent)  # type: ignore[arg-type]
    return Decoder(config, CAR_FOLLOWING_US101, types)


def random_graph(generator: torch.Generator, types: int = 2) -> Tensor:
    drawn = torch.randint(0, types, (5, 6), generator=generator)
    return dense(torch.nn.functional.one_hot(drawn, types).float())


def random_state(generator: torch.Generator) -> Tensor:
    """Far from zero, so that hidden layers saturate."""
    return torch.tensor([2000.0, 500.0, 100.0]) * torch.randn(5, 3, 3, generator=generator)


@pytest.mark.parametrize("driven", [2, 3])
@pytest.mark.parametrize("types", [2, 4])
@pytest.mark.parametrize("silent", [True, False])
def test_folding_changes_no_action(silent: bool, types: int, driven: int, generator: torch.Generator):
    policy, state = decoder("feed_forward", silent, types), random_state(generator)
    graph, memory = random_graph(generator, types)[:, :, :driven], torch.zeros(5, driven, 0)
    folded, defined = fast_decoder.bind(policy, graph)(state, memory)[0], policy.bind(graph)(state, memory)[0]
    torch.testing.assert_close(folded, defined, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("types", [2, 4])
@pytest.mark.parametrize("silent", [True, False])
def test_numpy_drives_as_torch_does(silent: bool, types: int, generator: torch.Generator):
    """In float32, up to its rounding."""
    policy, state = decoder("feed_forward", silent, types), random_state(generator)
    graph = random_graph(generator, types)
    by_numpy = fast_decoder.bind_numpy(policy, graph)
    assert by_numpy is not None
    expected = fast_decoder.bind(policy, graph)(state, torch.zeros(5, 3, 0))[0]
    torch.testing.assert_close(torch.from_numpy(by_numpy(state.numpy())), expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("driven", [1, 2, 3])
@pytest.mark.parametrize("types", [2, 4])
@pytest.mark.parametrize("silent", [True, False])
def test_few_calls_of_numpy_give_the_same_bits(silent: bool, types: int, driven: int, generator: torch.Generator):
    """Call by call, although results are written into the same arrays; no two scenes have the same graph."""
    policy, graph = decoder("feed_forward", silent, types), random_graph(generator, types)[:, :, :driven]
    few = fast_decoder.bind_numpy(policy, graph)
    assert isinstance(few, fast_decoder.FewVehicles)
    many, unit = fast_decoder.fold(policy, policy.body, graph).numpy(), policy.action_unit.numpy()  # type: ignore[arg-type]
    actions = []
    for _ in range(3):
        state = random_state(generator).numpy() / 10
        actions.append((few(state), many(state, state) * unit))
    for got, expected in actions:
        assert np.array_equal(got, expected)
    assert not np.array_equal(actions[0][0], actions[1][0])


@pytest.mark.parametrize("silent", [True, False])
def test_the_first_scenes_of_two_are_driven_as_alone(silent: bool, generator: torch.Generator):
    """In any order, although all write into the same arrays."""
    policy = decoder("feed_forward", silent, 2)
    follow = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW}, FOLLOWING, 2, batch=5)
    whole = fast_decoder.bind_numpy(policy, dense(follow.one_hot))
    assert isinstance(whole, fast_decoder.FewVehicles)
    firsts = {count: whole.first(count) for count in (1, 3)}
    assert [few.vehicles for few in firsts.values()] == [2, 6]
    for count in (3, 1, 5, 3):
        state = random_state(generator).numpy()[:count, :2] / 10
        alone = fast_decoder.bind_numpy(policy, dense(follow[:count].one_hot))
        assert alone is not None
        assert np.array_equal(firsts.get(count, whole)(state), alone(state))


def test_detached_senders_get_no_gradient(generator: torch.Generator):
    policy, state = decoder(), random_state(generator).requires_grad_()
    graph = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW}, FOLLOWING, batch=5).one_hot
    action, _ = fast_decoder.bind(policy, dense(graph), detach_senders=True)(state, torch.zeros(5, 3, 0))
    (gradient,) = torch.autograd.grad(action[:, 0].sum(), state)
    assert gradient[:, 1].abs().max() == 0
    assert gradient[:, 0].abs().max() > 0


def test_a_policy_with_a_memory_is_driven_by_torch(generator: torch.Generator):
    policy, graph = decoder("recurrent"), random_graph(generator)
    assert fast_decoder.bind_numpy(policy, graph) is None
    state, memory = random_state(generator), torch.zeros(5, 3, 16)
    assert torch.equal(fast_decoder.bind(policy, graph)(state, memory)[0], policy.bind(graph)(state, memory)[0])
