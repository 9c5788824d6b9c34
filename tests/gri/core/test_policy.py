import pytest
import torch

from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph
from gri.core.policy import ConstantVelocity, IntelligentDriver, PolicyState
from gri.core.trajectory import Trajectory


def test_constant_velocity_ends_acceleration_in_one_step():
    policy = ConstantVelocity(dt=0.2)
    state = torch.tensor([[[0.0, 10.0, -2.0], [20.0, 8.0, 1.0]]])
    action, _ = policy.act(policy.begin(Trajectory.complete(state[:, :, None], 0.2)), state)
    torch.testing.assert_close(action, torch.tensor([[[10.0], [-5.0]]]))


def test_intelligent_driver_by_hand():
    # gap 25 − 5 = 20, closing 2: s* = 2 + 10·1.5 + 10·2/(2·√(1·4)) = 22; a = 1·(1 − (10/20)⁴ − 1.21)
    policy = IntelligentDriver(
        dt=0.2, desired_speed=20.0, time_headway=1.5, minimum_gap=2.0, acceleration=1.0, deceleration=4.0
    )
    state = torch.tensor([[[0.0, 10.0, 0.0], [25.0, 8.0, 0.0]]])
    action, _ = policy.act(policy.begin(Trajectory.complete(state[:, :, None], 0.2)), state)
    expected = torch.tensor([(1 - 0.0625 - 1.21) / 0.2, (1 - (8 / 20) ** 4) / 0.2])
    torch.testing.assert_close(action[0, :, 0], expected)


@pytest.mark.parametrize("with_graph", [True, False])
def test_groups_can_be_taken_out_and_joined(with_graph: bool):
    graph = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW}, FOLLOWING, batch=3) if with_graph else None
    state = PolicyState(graph, torch.arange(9.0).reshape(3, 3, 1))
    joined = PolicyState.concatenate([state[torch.tensor([2])], state[:2]])
    assert joined.memory[:, 0, 0].tolist() == [6.0, 0.0, 3.0]
    assert len(joined) == 3
    assert (joined.graph is not None) == with_graph
