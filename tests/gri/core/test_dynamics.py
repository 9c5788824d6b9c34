import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gri.core.dynamics import (
    DUBINS,
    POINT_MASS_1D,
    POINT_MASS_2D,
    Dynamics,
    constant_speed,
    dynamics_named,
    stop_at_standstill,
    transition_matrix,
)

ALL = [POINT_MASS_1D, DUBINS, POINT_MASS_2D]


@pytest.mark.parametrize("dynamics", ALL, ids=lambda d: d.name)
@settings(deadline=None)
@given(seed=st.integers(0, 2**31), dt=st.floats(0.05, 1.0))
def test_inverse_of_step_is_the_action(dynamics: Dynamics, seed: int, dt: float):
    source = torch.Generator().manual_seed(seed)
    state = 5 * torch.randn(4, len(dynamics.state), generator=source, dtype=torch.float64)
    action = torch.randn(4, len(dynamics.action), generator=source, dtype=torch.float64)
    recovered = dynamics.inverse(state, dynamics.step(state, action, dt), dt)
    torch.testing.assert_close(recovered, action, rtol=1e-9, atol=1e-9)


def test_point_mass_by_hand():
    # x' = 1 + 2·0.5 + 4·0.125, v' = 2 + 4·0.5, a' = 4 + 6·0.5
    step = POINT_MASS_1D.step(torch.tensor([1.0, 2.0, 4.0]), torch.tensor([6.0]), 0.5)
    torch.testing.assert_close(step, torch.tensor([2.5, 4.0, 7.0]))


def test_point_mass_2d_moves_each_axis_as_the_1d_one():
    state, action = torch.randn(7, 6), torch.randn(7, 2)
    moved = POINT_MASS_2D.step(state, action, 0.2)
    for axis in (0, 1):
        alone = POINT_MASS_1D.step(state[:, axis::2], action[:, axis : axis + 1], 0.2)
        torch.testing.assert_close(moved[:, axis::2], alone)


def test_standstill_keeps_vehicles_that_move_forward():
    state = torch.tensor([0.0, 5.0, -1.0])
    moved = POINT_MASS_1D.step(state, torch.zeros(1), 0.2)
    assert torch.equal(stop_at_standstill(state, moved), moved)


def test_standstill_ends_a_braking_after_its_distance():
    # v = 0.5, a = −2: stops after v²/(2·2) = 0.0625 m, well before 0.5 s are over
    state = torch.tensor([10.0, 0.5, -2.0])
    stopped = stop_at_standstill(state, POINT_MASS_1D.step(state, torch.zeros(1), 0.5))
    torch.testing.assert_close(stopped, torch.tensor([10.0625, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("state", "moved", "wanted"),
    [
        ([10.0, 0.2, -1.0], [10.02, 0.0, -1.0], [10.02, 0.0, -1.0]),  # it stands just now
        ([10.0, 0.7, -1.0], [10.12, 0.5, -1.0], [10.12, 0.5, -1.0]),
        ([10.0, 0.01, -0.1], [10.0, -0.01, -0.1], [10.0005, 0.0, 0.0]),  # 0.01²/0.2
        ([10.0, -1.0, -0.5], [9.79, -1.1, -0.5], [10.0, 0.0, 0.0]),  # it reversed already
        ([10.0, 0.5, 0.0], [9.9, -1.0, 0.5], [10.0, 0.0, 0.0]),  # it does not brake: no braking distance
        ([10.0, 0.5, 0.25], [9.9, -1.0, 0.5], [10.0, 0.0, 0.0]),
    ],
)
def test_standstill_by_hand(state: list[float], moved: list[float], wanted: list[float]):
    stopped = stop_at_standstill(torch.tensor(state), torch.tensor(moved))
    torch.testing.assert_close(stopped, torch.tensor(wanted), rtol=1e-7, atol=0)


@pytest.mark.parametrize("speed", [0.0, 0.5])
def test_a_dubins_car_that_does_not_reverse_is_left_alone(speed: float):
    state = torch.tensor([10.0, 1.0, 1.0, 0.1, -2.0, 0.5])
    moved = torch.tensor([10.1, 1.0, speed, 0.2, -2.0, 0.5])
    assert DUBINS.stop is not None
    assert torch.equal(DUBINS.stop(state, moved), moved)


@pytest.mark.parametrize("dynamics", [POINT_MASS_1D, DUBINS], ids=lambda d: d.name)
def test_the_transition_matrix_is_the_step(dynamics: Dynamics, generator: torch.Generator):
    state = torch.randn(len(dynamics.state), generator=generator, dtype=torch.float64)
    action = torch.randn(len(dynamics.action), generator=generator, dtype=torch.float64)
    columns = [*state.tolist(), *action.tolist()]
    if dynamics is DUBINS:
        _, _, v, heading, *_ = state.tolist()
        columns += [v * np.cos(heading), v * np.sin(heading)]
    matrix = transition_matrix(dynamics, 0.2)
    assert matrix is not None
    np.testing.assert_allclose(matrix @ columns, dynamics.step(state, action, 0.2).numpy(), atol=1e-12)
    assert transition_matrix(POINT_MASS_2D, 0.2) is None


def test_dubins_by_hand():
    """60° to the left at 10 m/s for 0.1 s: 0.5 m along and 0.866 m to the left; 2 and 3 per s in a step of 0.1 s."""
    state = torch.tensor([1.0, 2.0, 10.0, np.pi / 3, 2.0, 3.0], dtype=torch.float64)
    moved = DUBINS.step(state, torch.tensor([5.0, 7.0], dtype=torch.float64), 0.1)
    wanted = [1.5, 2 + np.sqrt(0.75), 10.2, np.pi / 3 + 0.3, 2.5, 3.7]
    torch.testing.assert_close(moved, torch.tensor(wanted, dtype=torch.float64))


def test_the_speed_is_along_the_road_or_in_the_direction_of_travel():
    assert [dynamics.state[dynamics.speed] for dynamics in ALL] == ["v", "v", "vx"]


def test_a_dubins_car_stands_still_instead_of_reversing():
    state = torch.tensor([10.0, 1.0, 0.3, 0.1, -2.0, 0.5])
    moved = DUBINS.step(state, torch.zeros(2), 0.2)
    assert moved[2] < 0
    assert DUBINS.stop is not None
    stopped = DUBINS.stop(state, moved)
    torch.testing.assert_close(stopped, torch.tensor([*moved[:2].tolist(), 0.0, 0.1, 0.0, 0.0]))
    forward = DUBINS.step(state + torch.tensor([0, 0, 5.0, 0, 0, 0]), torch.zeros(2), 0.2)
    assert torch.equal(DUBINS.stop(state, forward), forward)


def test_unknown_dynamics_are_named():
    with pytest.raises(ValueError, match="unicycle"):
        dynamics_named("unicycle")


@pytest.mark.parametrize("dynamics", ALL, ids=lambda d: d.name)
def test_numpy_moves_as_torch_does(dynamics: Dynamics, generator: torch.Generator):
    state = 5 * torch.randn(4, 3, len(dynamics.state), generator=generator, dtype=torch.float64)
    action = torch.randn(4, 3, len(dynamics.action), generator=generator, dtype=torch.float64)
    moved = dynamics.step(state.numpy(), action.numpy(), 0.2)
    torch.testing.assert_close(torch.from_numpy(moved), dynamics.step(state, action, 0.2), rtol=0, atol=1e-12)


@pytest.mark.parametrize("dynamics", [POINT_MASS_1D, DUBINS], ids=lambda d: d.name)
def test_what_was_driven_first_can_be_learned_from_afterwards(dynamics: Dynamics):
    """Matrices that are kept from a drive under inference mode do not stand in the way of gradients."""
    dt = 0.123  # nobody else's, so that it is not kept yet
    state, action = torch.ones(1, len(dynamics.state)), torch.ones(1, len(dynamics.action))
    with torch.inference_mode():
        dynamics.step(state, action, dt)
    action.requires_grad_()
    dynamics.step(state, action, dt).sum().backward()
    assert action.grad is not None


def test_vehicles_at_constant_speed_go_straight_on():
    one = constant_speed(torch.tensor([[1.0, 5.0, 2.0]]), 2, POINT_MASS_1D, 0.2)
    assert one.tolist() == [[[1.0, 5.0, 0.0], [2.0, 5.0, 0.0], [3.0, 5.0, 0.0]]]
    two = constant_speed(torch.tensor([[1.0, 3.5, 5.0, 0.1, 1.0, 0.1]]), 1, DUBINS, 0.2)
    assert two[0, 1].tolist() == [2.0, 3.5, 5.0, 0.0, 0.0, 0.0]
