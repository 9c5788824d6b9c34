from dataclasses import replace
from typing import Literal

import pytest
import torch

from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph
from gri.core.policy import Policy, PolicyState
from gri.core.trajectory import Trajectory
from gri.networks import fast_decoder
from gri.networks.decoder import DecoderConfig, dense
from gri.networks.model import ModelConfig, RelationalModel, relative


@pytest.fixture
def model() -> RelationalModel:
    torch.manual_seed(0)
    return RelationalModel(ModelConfig(history_steps=10))


def history(generator: torch.Generator, groups: int = 2, steps: int = 12) -> Trajectory:
    return Trajectory.complete(torch.randn(groups, 3, steps, 3, generator=generator), 0.2)


def drive(policy: Policy, seen: Trajectory) -> tuple[torch.Tensor, PolicyState]:
    return policy.act(policy.begin(seen), seen.final)


def test_it_is_a_policy(model: RelationalModel, generator: torch.Generator):
    action, state = drive(model, history(generator))
    assert action.shape == (2, 3, 1)
    assert not action.requires_grad
    assert state.graph is not None
    assert len(state) == 2


def test_only_the_last_steps_of_a_longer_history_count(model: RelationalModel, generator: torch.Generator):
    long = history(generator, steps=30)
    short = Trajectory.complete(long.state[:, :, -10:], 0.2)
    assert model.begin(long).graph.probs.equal(model.begin(short).graph.probs)  # type: ignore[union-attr]


def test_without_an_encoder_it_believes_in_the_chain(generator: torch.Generator):
    model = RelationalModel(ModelConfig(encoder=None))
    graph = model.begin(history(generator)).graph
    assert graph is not None
    assert {pair: kind for pair, (kind, _) in graph.edges(1).items()} == {
        (1, 0): EdgeType.FOLLOW,
        (2, 1): EdgeType.FOLLOW,
    }


def test_the_graph_in_the_policy_state_is_the_one_it_drives_by(model: RelationalModel, generator: torch.Generator):
    seen = history(generator)
    driving_graph = model.begin(seen)
    none = InteractionGraph.of_edges({}, FOLLOWING, batch=2)
    follows = InteractionGraph.of_edges({(2, 0): EdgeType.FOLLOW}, FOLLOWING, batch=2)
    free, _ = model.act(replace(driving_graph, graph=none), seen.final)
    bound, _ = model.act(replace(driving_graph, graph=follows), seen.final)
    assert (free - bound)[:, 0].abs().max() > 1e-5
    torch.testing.assert_close(free[:, 1:], bound[:, 1:])


def test_far_down_the_road_it_drives_as_at_the_start(model: RelationalModel, generator: torch.Generator):
    seen = history(generator)
    graph = model.begin(seen)
    far = seen.final + torch.tensor([5000.0, 0.0, 0.0])
    torch.testing.assert_close(model.act(graph, far)[0], model.act(graph, seen.final)[0], atol=1e-4, rtol=1e-4)


def test_recurrent_memory_goes_from_step_to_step(generator: torch.Generator):
    torch.manual_seed(0)
    config = ModelConfig(history_steps=10, decoder=ModelConfig().decoder.__class__(kind="recurrent", hidden=8))
    model, seen = RelationalModel(config), history(generator)
    first, state = drive(model, seen)
    second, _ = model.act(state, seen.final)
    assert state.memory.shape == (2, 3, 8)
    assert (first - second).abs().max() > 0


def test_a_history_with_holes_is_refused(model: RelationalModel, generator: torch.Generator):
    seen = history(generator)
    holes = Trajectory(seen.state, seen.valid.clone().index_fill(2, torch.tensor(3), False), 0.2)
    with pytest.raises(ValueError, match="6 missing states"):
        model.begin(holes)


def test_a_history_at_another_rate_is_refused(model: RelationalModel, generator: torch.Generator):
    with pytest.raises(ValueError, match=r"every 0.1 s, .* wants 0.2 s"):
        model.begin(replace(history(generator), dt=0.1))


def test_a_replaced_graph_counts_at_once(model: RelationalModel, generator: torch.Generator):
    seen = history(generator)
    state = model.eval().begin(seen)
    assert state.graph is not None
    other = replace(state, graph=replace(state.graph, logits=state.graph.logits.flip(-1)))
    first, second = model.act(state, seen.final)[0], model.act(other, seen.final)[0]
    assert not torch.equal(first, second)
    torch.testing.assert_close(model.act(state, seen.final)[0], first, rtol=0, atol=0)


@pytest.mark.parametrize("kind", ["feed_forward", "recurrent"])
def test_it_drives_by_its_decoder(kind: Literal["feed_forward", "recurrent"], generator: torch.Generator):
    """`act`, which may go by numpy, is the decoder that was trained."""
    torch.manual_seed(0)
    model = RelationalModel(ModelConfig(history_steps=10, decoder=DecoderConfig(kind=kind)))
    seen = history(generator)
    action, memory = drive(model, seen)
    assert memory.graph is not None
    act = fast_decoder.bind(model.decoder, dense(memory.graph.one_hot))
    expected, recurrent = act(relative(seen.final), model.memory(seen.final))
    torch.testing.assert_close(action, expected, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(memory.memory, recurrent)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_states_that_are_not_finite_are_an_error_and_not_an_empty_graph(model: RelationalModel, value: float):
    state = torch.zeros(1, 3, 10, 3)
    state[0, 1, 4, 1] = value
    with pytest.raises(ValueError, match="not finite"):
        model.infer(state)


def test_a_history_that_is_too_short_is_an_error(model: RelationalModel, generator: torch.Generator):
    with pytest.raises(ValueError, match="4 states, wanted at least 5"):
        model.infer(torch.zeros(1, 3, 4, 3))
    seen = history(generator)
    with pytest.raises(ValueError, match="9 states, the model wants 10"):
        model.begin(Trajectory(seen.state[:, :, :9], seen.valid[:, :, :9], 0.2))
