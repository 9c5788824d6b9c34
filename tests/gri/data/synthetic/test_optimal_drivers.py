import pytest
import torch

from gri.core.dynamics import DUBINS, stop_dubins_at_standstill
from gri.core.scenes import Scenes
from gri.data.ranges.highway_merge import HIGHWAY_MERGE
from gri.data.synthetic.expert import returns, true_reward
from gri.data.synthetic.optimal_drivers import in_contact, make_highway_scenes

SCENES = HIGHWAY_MERGE


@pytest.fixture(scope="module")
def made() -> Scenes:
    return make_highway_scenes(SCENES, "mixed", 16, seed=3)


def test_shares_are_those_of_the_range(made: Scenes):
    assert len(made) == 16
    counts = sorted(made.graph.unique(dim=0, return_counts=True)[1].tolist())
    assert counts == [2, 2, 2, 10]  # 0.15·16 = 2.4, 0.1·16 = 1.6; the first graph takes the rest


def test_states_follow_from_actions_and_begin_where_the_history_ends(made: Scenes):
    before = made.state[:, :2, :-1]
    moved = stop_dubins_at_standstill(before, DUBINS.step(before, made.action, SCENES.dt))
    torch.testing.assert_close(made.state[:, :2, 1:], moved, atol=1e-3, rtol=1e-3)
    assert made.history is not None
    assert torch.equal(made.history[:, :, -1], made.start)
    assert made.observed is made.history
    assert made.state[:, :2, :, 2].min() >= 0


def test_mergers_merge_behind_the_leader_and_without_contact(made: Scenes):
    merging = made.graph[:, 0] == 2  # 1 yields to 0
    x, y = made.state[merging][..., 0], made.state[merging][..., 1]
    assert (x[:, 2, -1] - x[:, 0, -1] > 5.0).all()
    assert (y[:, 0, -1].abs() < 0.97).float().mean() > 0.6  # inside the lane; others still make room
    assert not in_contact(made.state[merging]).any()


def test_nobody_gains_by_another_jerk(made: Scenes):
    """Constant changes of one vehicle's jerk or yaw acceleration lower its return."""
    reward = true_reward(SCENES)
    graph = made.one_hot(4)

    def value(action: torch.Tensor) -> torch.Tensor:
        states = [made.start]
        for t in range(action.shape[2]):
            here = states[-1][:, :2]
            moved = stop_dubins_at_standstill(here, DUBINS.step(here, action[:, :, t], SCENES.dt))
            states.append(torch.cat([moved, made.leader[:, None, t + 1]], 1))
        return returns(reward, torch.stack(states, 2), action, graph).sum(-1)[:, 0]

    best = value(made.action)
    for change in (0.3, -0.3):
        for feature in (0, 1):
            other = made.action.clone()
            other[:, 0, :10, feature] += change
            assert (value(other) <= best + 0.02 * best.abs()).float().mean() >= 0.9


def test_contact_is_common_length_and_width():
    state = torch.zeros(1, 3, 2, 6)
    state[0, 1, :, 0] = -20.0
    state[0, 2, :, 0] = 4.0
    state[0, 0, :, 1] = -3.7
    assert not in_contact(state).any()
    state[0, 0, 1, 1] = -1.9
    assert in_contact(state).all()
    state[0, 2, :, 0] = 5.1
    assert not in_contact(state).any()
