"""Effects of edges: known by hand for a constructed policy, computed otherwise for released ones, 0 for idle edges."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from cosim.show.action_effects import (
    AGREES,
    Drive,
    Outside,
    drive_of,
    effect_of_vehicle,
    effect_since_takeover,
    effects_of,
)
from cosim.show.episode_view import EpisodeView, InferredEdge
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import Scenario
from cosim.world.episode import COLUMNS
from gri import checkpoint
from gri.core.dynamics import DUBINS, POINT_MASS_1D, Dynamics
from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph
from gri.core.policy import IntelligentDriver, PolicyState
from gri.core.trajectory import Trajectory
from gri.networks.model import CHAIN, MERGE
from gri.networks.next_ahead import FollowsNextAhead

DT = 0.2


@dataclass(frozen=True)
class ByHand:
    """Jerk +1 m/s³, and −3 m/s³ more for a vehicle that follows vehicle 1; edges from vehicle 2 change nothing."""

    dt: float = DT
    dynamics: Dynamics = POINT_MASS_1D
    history_steps: int = 1

    def begin(self, history: Trajectory) -> PolicyState:
        chain = {(1, 0): EdgeType.FOLLOW, (2, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW}
        return replace(PolicyState.empty(history), graph=InteractionGraph.of_edges(chain, FOLLOWING))

    def act(self, memory: PolicyState, state: torch.Tensor) -> tuple[torch.Tensor, PolicyState]:
        assert memory.graph is not None
        jerk = torch.ones(*state.shape[:2], 1)
        for sender, receiver in memory.graph.edges():
            jerk[:, receiver] -= 3.0 * (sender == 1)
        return jerk, memory


def driven(policy, edges: dict[tuple[int, int], EdgeType], start: torch.Tensor, steps: int = 20) -> torch.Tensor:
    """The states [T, 3, D] of a drive by the policy; vehicle 2 brakes at 1 m/s², or keeps its heading and speed."""
    history = Trajectory.complete(start[None, :, None].repeat(1, 1, policy.history_steps, 1).float(), DT)
    memory = policy.begin(history)
    if edges:
        memory = replace(memory, graph=InteractionGraph.of_edges(edges, memory.graph.vocabulary))
    states = [start.double()]
    for _ in range(steps):
        seen = states[-1].clone()
        seen[:, 0] -= states[-1][2, 0]
        action, memory = policy.act(memory, seen[None].float())
        action[:, 2] = 0.0
        after = policy.dynamics.step(states[-1][None], action.double(), DT)[0]
        states.append(after)
    return torch.stack(states)


def in_one_lane(states: torch.Tensor) -> Drive:
    edges = {(1, 0): EdgeType.FOLLOW, (2, 0): EdgeType.FOLLOW}
    return Drive(states, states[:1].transpose(0, 1), [edges] * len(states))


def test_a_policy_that_follows_who_is_ahead_has_a_reason_without_an_edge():
    """The lag vehicle lets the merging one in; its graph has no edge from the slower leader, behind which it brakes."""
    policy = FollowsNextAhead(checkpoint.load("us101_merge"))
    start = torch.tensor([[-45.0, -3.75, 12.0, 0, 0, 0], [-20.0, 0.0, 12.0, 0, 0, 0], [0.0, 0.0, 6.0, 0, 0, 0]])
    edges = {(2, 0): EdgeType.FOLLOW, (1, 0): EdgeType.CUT_IN, (0, 1): EdgeType.YIELD}
    states = driven(policy, edges, start)
    drive = Drive(states, states[:1].transpose(0, 1), [edges] * len(states))
    found = {effect.reason: effect for effect in effects_of(drive, policy, [1])}
    assert list(found) == ["yield 0", "ahead 2"]
    assert found["ahead 2"].agrees[:10].all()
    assert found["ahead 2"].second[:10].min() < -0.3
    assert effect_since_takeover(drive, policy, 2, 1, 5) < -0.1
    assert [effect.reason for effect in effects_of(drive, policy.model, [1])] == ["yield 0"]


def test_others_that_are_near_are_seen_ahead():
    others = Outside(
        *np.array([[40.0, 60.0, 30.0], [0.0, 0.0, 3.5], [9.0, 5.0, 1.0], [5.0, 5.0, 5.0], [1.8, 1.8, 1.8]])
    )
    found = others.next_ahead(np.array([20.0, 50.0, 70.0]), np.array([0.0, 0.1, 0.0]))
    np.testing.assert_allclose(found.gap, [[15.0, 5.0, np.inf]])
    np.testing.assert_allclose(found.v, [[9.0, 5.0, 0.0]])
    nobody = Outside(*np.zeros((5, 0))).next_ahead(np.zeros(3), np.zeros(3))
    assert np.isinf(nobody.gap).all()


def test_a_vehicle_outside_the_group_is_no_reason_but_counts_in_every_decision():
    policy, edges = FollowsNextAhead(checkpoint.load("us101_car_following")), {(2, 1): EdgeType.FOLLOW}
    start = torch.tensor([[0.0, 15.0, 0.0], [60.0, 15.0, 0.0], [90.0, 15.0, 0.0]])
    states = driven(policy, edges, start)
    slow = [Outside(*np.array([[20.0], [0.0], [5.0], [5.0], [1.8]]))] * len(states)
    alone = Drive(states, states[:1].transpose(0, 1), [edges] * len(states))
    beside = replace(alone, outside=slow, origin=(np.zeros(3), 0.0))
    assert effect_of_vehicle(alone, policy, 2, [1], 10)[0] == pytest.approx(0.0, abs=1e-6)
    assert abs(effect_of_vehicle(beside, policy, 2, [0, 1], 10)[0]) > 0.3, (
        "0 brakes for it, and was recorded without it"
    )


START = torch.tensor([[0.0, 20.0, 0.0], [35.0, 20.0, 0.0], [70.0, 20.0, -0.5]])


def test_effects_of_a_policy_that_is_known_by_hand():
    policy = ByHand()
    found = {effect.reason: effect for effect in effects_of(in_one_lane(driven(policy, {}, START)), policy, [0])}
    assert list(found) == ["follow 1", "follow 2", "follow 1 and follow 2"]
    follow = found["follow 1"]
    assert follow.agrees.all()
    np.testing.assert_allclose(follow.time[:2], [0.2, 0.4])
    np.testing.assert_allclose(follow.acceleration[:2], [-0.4, -0.8], atol=1e-9)
    np.testing.assert_allclose(follow.decision, -3.0 * DT, atol=1e-6)
    np.testing.assert_allclose(follow.second[:6], [-0.6, -1.2, -1.8, -2.4, -3.0, -3.0], atol=1e-6)
    np.testing.assert_allclose(found["follow 1 and follow 2"].second, follow.second, atol=1e-9)
    assert not follow.lateral.any()


def test_an_edge_that_does_not_matter_has_no_effect():
    policy = ByHand()
    idle = effects_of(in_one_lane(driven(policy, {}, START)), policy, [0])[1]
    assert idle.reason == "follow 2"
    assert not idle.decision.any()
    np.testing.assert_allclose(idle.second, 0.0, atol=1e-12)


def test_a_drive_of_another_policy_is_noticed():
    states = driven(ByHand(), {}, START)
    states[10:, 0, 2] += 2 * AGREES
    effect = effects_of(in_one_lane(states), ByHand(), [0])[0]
    assert np.flatnonzero(~effect.agrees).tolist() == [9], "only the acceleration after this decision is another one"


def test_the_vehicle_ahead_matters_to_idm_and_no_other():
    policy = IntelligentDriver(DT)
    states = driven(policy, {}, START)
    drive = Drive(states, states[:1].transpose(0, 1), [])
    found = {(e.receiver, e.reason): e for e in effects_of(drive, policy, [0, 1])}
    assert (found[0, "vehicle 1"].second[4:] < -0.05).all()
    for idle in ((0, "vehicle 2"), (1, "vehicle 0")):
        assert np.abs(found[idle].second).max() < 1e-4


def view_of(
    episode: EpisodeView, scenario: Scenario, states: torch.Tensor, edges: dict[tuple[int, int], EdgeType]
) -> EpisodeView:
    """The drive as the tables would hold it; roads run straight along s."""
    dynamics = DUBINS if states.shape[-1] == 6 else POINT_MASS_1D
    state = np.zeros((len(states), 3, len(COLUMNS)))
    for name, feature in (("s", "x"), ("x", "x"), ("d", "y"), ("y", "y"), ("v", "v"), ("a", "a")):
        if feature in dynamics.state:
            state[..., COLUMNS.index(name)] = states[..., dynamics.index(feature)].numpy()
    count = len(states)
    all_pairs = [(i, j) for i in range(3) for j in range(3) if i != j]
    group = dict(episode.group) | {f"length_{role}": 5.0 for role in range(3)} | {"takeover_time": 0.0}
    return replace(
        episode,
        group=group,
        time=scenario.step * np.arange(count),
        state=state,
        present=np.ones((count, 3), dtype=bool),
        driven=np.tile([True, True, False], (count, 1)),
        during_drive=np.ones(count, dtype=bool),
        gap=np.ones((count, 3)),
        ttc=np.full((count, 3), np.inf),
        inferred_edges=tuple(InferredEdge(0.0, i, j, str(edges.get((i, j), "none")), 1.0) for i, j in all_pairs),
    )


MERGING = torch.tensor(
    [[0.0, -3.6, 12.0, 0.0, 0.0, 0.0], [-15.0, 0.0, 12.0, 0.0, 0.0, 0.0], [20.0, 0.0, 11.0, 0.0, 0.0, 0.0]]
)


@pytest.mark.parametrize(
    ("name", "start", "paper"), [("us101_car_following", START, CHAIN), ("us101_merge", MERGING, MERGE)]
)
def test_a_released_model_gives_its_actions_again_from_the_tables(episode, name, start, paper):
    """The states of the tables are the model's own, and an effect is the difference of two calls of the model."""
    scenario, model = load_scenario(name), checkpoint.load(name)
    edges = {(edge.sender, edge.receiver): edge.type for edge in paper}
    states = driven(model, edges, start)
    drive = drive_of(view_of(episode, scenario, states, edges), scenario)
    shifted = states[: len(drive.state)].clone()
    shifted[..., 0] -= states[0, 2, 0].clone()
    torch.testing.assert_close(drive.state[:, :2], shifted[:, :2], atol=1e-9, rtol=0)
    found = effects_of(drive, model, [0, 1])
    assert {(e.receiver, e.reason) for e in found if " and " not in e.reason} == {
        (j, f"{kind} {i}") for (i, j), kind in edges.items()
    }
    for effect in found:
        assert effect.agrees.all()
        assert np.abs(effect.second).max() > 0.02, effect.reason
    (sender, receiver), kind = next(iter(edges.items()))
    without = {pair: other for pair, other in edges.items() if pair != (sender, receiver)}
    state = drive.state.clone()
    state[..., 0] -= drive.state[:, 2:, 0]
    actions = [
        model.act(PolicyState(graph, model.memory(state.float())), state.float())[0][:-1, receiver, 0]
        for graph in (
            InteractionGraph.of_edges(which, model.config.vocabulary, batch=len(state)) for which in (edges, without)
        )
    ]
    effect = next(e for e in found if (e.receiver, e.reason) == (receiver, f"{kind} {sender}"))
    np.testing.assert_allclose(effect.decision, DT * (actions[0] - actions[1]).numpy(), atol=1e-5)
