"""Policies of the project in the grid of cut-ins."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from gri.core.dynamics import DUBINS, POINT_MASS_1D, POINT_MASS_2D, Dynamics
from gri.core.merging_policy import MergingDriver
from gri.core.policy import ConstantVelocity, IntelligentDriver, PolicyState
from gri.errors import InputError
from gri.reference_drivers.cut_in_grid import Grid, OtherCar, drive
from gri.reference_drivers.policy_in_grid import PolicyControl, drive_policy

GRID = Grid.of((40, 60), (10, 30), (5, 25, 45), (0.0, 0.5, 1.5))


def never_reacts(now, live):
    return np.zeros(len(live)), np.zeros(len(live), dtype=bool)


@pytest.mark.parametrize("dynamics", [DUBINS, POINT_MASS_1D])
@pytest.mark.parametrize("dt", [0.1, 0.2])
def test_constant_velocity_collides_like_an_ego_that_never_reacts(dynamics, dt):
    driven = drive_policy(ConstantVelocity(dt, dynamics), GRID)
    assert driven.collided.tolist() == drive(GRID, never_reacts).collided.tolist()


@pytest.mark.parametrize("policy", [IntelligentDriver(0.1), MergingDriver(IntelligentDriver(0.2))])
def test_a_driver_that_reacts_collides_less_and_gets_slower(policy):
    driven, unreacting = drive_policy(policy, GRID), drive(GRID, never_reacts)
    assert 0 < driven.collided.sum() < unreacting.collided.sum()
    assert driven.slowed[unreacting.collided & ~driven.collided].min() > 0


@dataclass(frozen=True)
class Recorder:
    """Drives at constant speed and remembers what it saw."""

    seen: list
    dynamics: Dynamics = DUBINS
    dt: float = 0.2
    history_steps: int = 5

    def begin(self, history):
        self.seen.append(history.state.clone())
        return PolicyState.empty(history)

    def act(self, memory, state):
        self.seen.append(state.clone())
        return torch.zeros(*state.shape[:2], len(self.dynamics.action)), memory


def test_the_scene_shows_the_gap_and_the_lateral_motion_of_the_other():
    grid = Grid.of((60,), (30,), (20,), (1.5,))
    policy = Recorder([])
    drive(grid, PolicyControl(policy, grid))
    history, *states = policy.seen
    assert history.shape == (1, 3, 5, 6)
    assert torch.diff(history[0, 1, :, 0]).tolist() == pytest.approx([60 / 3.6 * 0.2] * 4, rel=1e-4)
    start = states[OtherCar.of(grid).ramp // 2][0]  # the ramp of 10 steps has 5 periods of 0.2 s
    assert float(start[0, 0] - start[1, 0]) == pytest.approx(20 + 5, abs=1e-4)
    assert float(start[0, 1]) == pytest.approx(-3.5)
    assert float(start[0, 2] * torch.sin(start[0, 3])) == pytest.approx(1.5, abs=1e-5)
    assert float(states[-1][0, 0, 1]) == pytest.approx(0.0)


def test_in_one_lane_the_other_is_seen_once_it_overlaps():
    grid = Grid.of((60,), (50,), (40,), (1.0,))
    policy = Recorder([], dynamics=POINT_MASS_1D)
    drive(grid, PolicyControl(policy, grid))
    ahead = [float(state[0, 2, 0] - state[0, 1, 0]) for state in policy.seen[1:]]
    first = next(k for k, distance in enumerate(ahead) if distance < 100)
    assert ahead[0] == pytest.approx(500, abs=1)
    assert first == (OtherCar.of(grid).ramp + 16) // 2 + 1  # 1.6 m at 1 m/s, every 0.2 s


@pytest.mark.parametrize(
    ("policy", "said"),
    [(ConstantVelocity(0.1, POINT_MASS_2D), "point_mass_2d"), (ConstantVelocity(0.25), "multiple of 0.1 s")],
)
def test_policies_that_do_not_fit_are_refused(policy, said):
    with pytest.raises(InputError, match=said):
        drive_policy(policy, GRID)
