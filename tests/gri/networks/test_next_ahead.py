"""A policy that follows whoever is next ahead, beside the same model that knows its graph only."""

import pytest
import torch

from gri import checkpoint
from gri.core.graph import EdgeType, InteractionGraph
from gri.core.nearby import Nearby, NextAhead
from gri.core.policy import PolicyState
from gri.core.trajectory import Trajectory
from gri.networks.decoder import DecoderConfig
from gri.networks.model import ModelConfig, RelationalModel
from gri.networks.next_ahead import FollowsNextAhead
from gri.resources import shipped


@pytest.fixture(scope="module")
def merge():
    return checkpoint.load(shipped("gri", "checkpoints", "us101_merge.safetensors"))


@pytest.fixture(scope="module")
def lane():
    return checkpoint.load(shipped("gri", "checkpoints", "us101_car_following.safetensors"))


def state(*vehicles: tuple[float, float, float]) -> torch.Tensor:
    """Merge states of vehicles at (x, y, v)."""
    rows = [[x, y, v, 0.0, 0.0, 0.0] for x, y, v in vehicles]
    return torch.tensor([rows])


def memory(model, edges) -> PolicyState:
    return PolicyState(InteractionGraph.of_edges(edges, model.config.vocabulary), torch.zeros(1, 3, 0))


MERGE = {(2, 0): EdgeType.FOLLOW, (1, 0): EdgeType.CUT_IN, (0, 1): EdgeType.YIELD}
BESIDE = (-30.0, -3.75, 12.0), (-12.0, 0.0, 12.0), (0.0, 0.0, 2.0)  # 1 is close behind a slow leader, 0 far back


def nearby(ahead: float, across: float, v: float, length: float = 5.0) -> Nearby:
    """One vehicle, at the same distance from all three."""
    return Nearby(
        ahead=torch.full((1, 3, 1), ahead),
        across=torch.full((1, 3, 1), across),
        v=torch.tensor([[v]]),
        length=torch.tensor([[length]]),
        width=torch.tensor([[1.8]]),
        present=torch.tensor([[True]]),
    )


def test_a_lag_vehicle_brakes_for_the_leader_that_its_graph_does_not_name(merge):
    policy, now, given = FollowsNextAhead(merge), state(*BESIDE), memory(merge, MERGE)
    plain, _ = merge.act(given, now)
    careful, _ = policy.act(given, now)
    assert careful[0, 1, 0] < plain[0, 1, 0] - 0.5, "it closes at 10 m/s with 7 m between them"
    torch.testing.assert_close(careful[0, 0], plain[0, 0])  # nobody is ahead of the merging vehicle in its lane
    torch.testing.assert_close(careful[..., 1], plain[..., 1])  # across the road the graph decides


def test_the_answer_is_that_of_the_model_under_follow(merge):
    policy, now, given = FollowsNextAhead(merge), state(*BESIDE), memory(merge, MERGE)
    pair = now[:, 1:]
    follow = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW}, merge.config.vocabulary, 2)
    behind, _ = merge.act(PolicyState(follow, torch.zeros(1, 2, 0)), pair)
    torch.testing.assert_close(policy.act(given, now)[0][0, 1, 0], behind[0, 0, 0])


def test_who_is_next_ahead(merge):
    policy, now = FollowsNextAhead(merge), state((-20.0, -3.75, 10.0), (-40.0, 0.0, 10.0), (0.0, 0.2, 10.0))
    gap, who, other = policy.next_ahead(now.numpy(), None)
    assert gap[0].tolist() == [float("inf"), pytest.approx(35.0), float("inf")]
    assert who.tolist() == [1]
    assert other[0].tolist() == now[0, 2].tolist()
    gap, who, other = policy.next_ahead(now.numpy(), NextAhead.of(nearby(15.0, 0.0, 3.0, length=12.0)))
    assert gap[0].tolist() == pytest.approx([3.0, 3.0, 3.0])  # nearer than the leader is to the lag vehicle
    assert who.tolist() == [0, 1, 2]
    assert other[1].tolist() == pytest.approx([-32.0, 0.0, 3.0, 0.0, 0.0, 0.0])  # as if it were 5 m long
    assert other[0, 1].item() == -3.75, "beside nobody: in the lane of the vehicle itself"
    beside, *_ = policy.next_ahead(now.numpy(), NextAhead.of(nearby(15.0, 3.6, 3.0)))
    assert beside[0].tolist() == policy.next_ahead(now.numpy(), None)[0][0].tolist()


@pytest.mark.parametrize(("heading", "followed"), [(0.0, False), (0.2, True), (-0.2, False)])
def test_a_vehicle_that_moves_over_is_in_the_path_a_second_before(merge, heading, followed):
    """Vehicle 0 is 3 m beside vehicle 1 and ahead of it; at 10 m/s and 0.2 rad it comes 2 m nearer in a second."""
    now = state((-10.0, -3.0, 10.0), (-30.0, 0.0, 10.0), (500.0, 0.0, 10.0))
    now[0, 0, merge.dynamics.index("heading")] = heading
    gap, *_ = FollowsNextAhead(merge).next_ahead(now.numpy(), None)
    assert gap[0, 1].item() == pytest.approx(15.0 if followed else 525.0)
    assert gap[0, 0].item() == pytest.approx(505.0) if followed else gap[0, 0].item() == float("inf")


def test_a_vehicle_of_the_surrounding_traffic_is_followed(merge):
    policy, now, given = FollowsNextAhead(merge), state(*BESIDE), memory(merge, MERGE)
    free, held = (policy.act(given, now, near)[0][0, 0, 0] for near in (None, nearby(12.0, 0.0, 2.0)))
    assert held < free - 0.5


def test_nobody_ahead_changes_nothing(merge):
    now = state((-20.0, -3.75, 10.0), (-10.0, -7.5, 10.0), (0.0, 0.0, 10.0))
    given = memory(merge, MERGE)
    torch.testing.assert_close(FollowsNextAhead(merge).act(given, now)[0], merge.act(given, now)[0], rtol=0, atol=0)


def test_a_vehicle_that_is_not_to_be_seen_changes_nothing(merge):
    now, given = state(*BESIDE), memory(merge, MERGE)
    alone, everybody = merge.act(given, now)[0].clone(), FollowsNextAhead(merge).act(given, now)[0].clone()
    blind = FollowsNextAhead(merge).without([(2, 1)]).act(given, now)[0]
    assert everybody[0, 1, 0] < alone[0, 1, 0] - 0.5
    assert blind[0, 1, 0] == alone[0, 1, 0]
    assert blind[0, 0, 0] == everybody[0, 0, 0], "others see as before"


@pytest.mark.parametrize("v", [12.0, 16.0])
def test_a_fast_vehicle_stays_in_the_lane_that_it_merges_into(merge, v):
    """Nobody is near, and the leader far ahead. The model alone swings into the lane behind; y grows that way."""
    farthest = {}
    for policy in (merge, FollowsNextAhead(merge)):
        now, given, y = state((-80.0, -3.75, v), (-160.0, 0.0, 8.0), (0.0, 0.0, v)), memory(merge, MERGE), []
        for _ in range(50):
            action = policy.act(given, now)[0].clone()
            action[:, 1:] = 0.0
            now = policy.dynamics.step(now, action, policy.dt)
            y.append(float(now[0, 0, 1]))
        farthest[policy is merge] = max(y)
    assert farthest[True] > 1.2
    assert -0.3 < farthest[False] < 0.7


def test_it_follows_in_one_lane_too(lane):
    policy, none = FollowsNextAhead(lane), memory(lane, {})
    now = torch.tensor([[[-30.0, 12.0, 0.0], [-12.0, 12.0, 0.0], [0.0, 2.0, 0.0]]])
    plain, careful = lane.act(none, now)[0], policy.act(none, now)[0]
    assert careful[0, 1, 0] < plain[0, 1, 0] - 0.5
    assert (careful <= plain).all()


def test_batches_of_any_size(merge):
    policy = FollowsNextAhead(merge)
    one, two = state(*BESIDE), state((-20.0, -3.75, 10.0), (-40.0, 0.0, 10.0), (0.0, 0.0, 10.0))
    graph = InteractionGraph.of_edges(MERGE, merge.config.vocabulary, batch=2)
    together, _ = policy.act(PolicyState(graph, torch.zeros(2, 3, 0)), torch.cat([one, two]))
    for k, alone in enumerate((one, two)):
        torch.testing.assert_close(together[k], policy.act(memory(merge, MERGE), alone)[0][0])


def test_reading_the_history_is_left_to_the_model(merge):
    policy = FollowsNextAhead(merge)
    assert (policy.dt, policy.history_steps, policy.dynamics) == (merge.dt, merge.history_steps, merge.dynamics)
    states = state(*BESIDE)[:, :, None].expand(-1, -1, merge.history_steps, -1)
    history = Trajectory.complete(states, merge.dt)
    torch.testing.assert_close(policy.begin(history).graph.logits, merge.begin(history).graph.logits)


def test_a_model_with_a_memory_is_refused():
    recurrent = ModelConfig(history_steps=10, decoder=DecoderConfig(kind="recurrent", hidden=8))
    with pytest.raises(ValueError, match="feed-forward"):
        FollowsNextAhead(RelationalModel(recurrent))


def test_a_model_that_does_not_know_following_is_refused():
    yielding = ModelConfig(vocabulary=(EdgeType.NONE, EdgeType.YIELD))
    with pytest.raises(ValueError, match="follow"):
        FollowsNextAhead(RelationalModel(yielding))
