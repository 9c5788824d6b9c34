"""Perturbed observations and actions, by hand and statistically."""

import pytest
import torch

from cosim.perturb.sensing_and_control import RoundSetting, sensing_and_control
from cosim.spec.perturbations import (
    ActionDelay,
    ActionNoise,
    Dropout,
    HeadwayRatio,
    Latency,
    LowFriction,
    ObservationNoise,
)
from gri.core.dynamics import DUBINS, POINT_MASS_1D


def setting(dynamics=POINT_MASS_1D, names=("a b c", "d e f"), seed=1, steps=400):
    past = tuple(torch.full((len(names), 3, len(dynamics.state)), -float(k)) for k in (3, 2, 1))
    return RoundSetting(dynamics, 0.2, steps, seed, names, (0, 1), past)


def observed(spec, value=None, count=5, **options):
    """What comes out of the observation channel when the k-th state is filled with k."""
    chosen = setting(**options)
    made = sensing_and_control((spec,), chosen)
    shape = (len(chosen.names), 3, len(chosen.dynamics.state))
    filled = [torch.full(shape, float(k) if value is None else value, dtype=torch.float64) for k in range(count)]
    return torch.stack([made.observed_state(k, state) for k, state in enumerate(filled)])


def test_other_perturbations_leave_the_channels_as_they_are():
    made = sensing_and_control((HeadwayRatio(intensity=0.5),), setting())
    state, action = torch.ones(2, 3, 3), torch.ones(2, 3, 1)
    assert made.observed_state(0, state) is state
    assert made.executed_action(0, action) is action
    assert made.feasible_state(state) is state


def test_latency_shows_the_past_and_what_was_before_the_take_over():
    """0.4 s are two steps: first come the states before the last one of the history (−2 and −1), then 0, 1, …"""
    assert observed(Latency(intensity=0.4))[:, 0, 0, 0].tolist() == [-2, -1, 0, 1, 2]
    assert observed(Latency(intensity=0.0))[:, 0, 0, 0].tolist() == [0, 1, 2, 3, 4]
    assert observed(Latency(intensity=1.0))[:, 1, 2, 0].tolist() == [-3, -3, -3, -2, -1]


@pytest.mark.parametrize("spec", [Latency(intensity=0.4), Dropout(intensity=1.0)], ids=lambda spec: spec.kind)
def test_a_driver_knows_its_own_acceleration_and_yaw_rate_at_once(spec):
    found = observed(spec, dynamics=DUBINS)
    now = torch.arange(5.0, dtype=torch.float64)
    for role in (0, 1):
        assert torch.equal(found[:, 0, role, [DUBINS.index("a"), DUBINS.index("yaw_rate")]], now[:, None].expand(5, 2))
        assert (found[1:, 0, role, : DUBINS.index("a")] < now[1:, None]).all()
    assert (found[1:, 0, 2] < now[1:, None]).all()  # of the vehicle that it does not drive it knows nothing more


def test_delayed_actions_begin_with_none():
    made = sensing_and_control((ActionDelay(intensity=0.6),), setting())
    out = [made.executed_action(k, torch.full((2, 3, 1), 7.0 + k)).flatten()[0].item() for k in range(5)]
    assert out == [0, 0, 0, 7, 8]


def test_dropout_holds_what_was_seen_last():
    found = observed(Dropout(intensity=0.5), count=400)
    step = found[1:] - found[:-1]
    current = torch.arange(400.0, dtype=torch.float64)[:, None, None] - found[..., 0]
    assert (found[0] == 0).all()
    assert (step >= 0).all()  # never older than what was shown before
    share = (current[1:] > 0).double().mean().item()
    assert share == pytest.approx(0.5, abs=0.04)
    assert (found[..., 0] == found[..., 1]).all()  # position and speed are observed together or not at all


def test_dropout_of_everything_shows_the_first_state_for_ever():
    assert (observed(Dropout(intensity=1.0))[..., :2] == 0).all()


def test_observation_noise_has_its_standard_deviations():
    found = observed(ObservationNoise(intensity=2.0), value=0.0, count=400, dynamics=DUBINS)
    expected = {"x": 2.0, "y": 0.4, "v": 1.0, "heading": 0.0, "a": 0.0, "yaw_rate": 0.0}
    for name, sigma in expected.items():
        assert found[..., DUBINS.index(name)].std().item() == pytest.approx(sigma, rel=0.06)
    assert abs(found[..., 0].mean().item()) < 0.15


def test_action_noise_has_its_standard_deviations():
    made = sensing_and_control((ActionNoise(intensity=3.0),), setting(DUBINS))
    out = torch.stack([made.executed_action(k, torch.zeros(2, 3, 2)) for k in range(400)])
    assert out[..., 0].std().item() == pytest.approx(3.0, rel=0.06)
    assert out[..., 1].std().item() == pytest.approx(0.06, rel=0.06)


def test_noise_belongs_to_the_group_and_the_seed_and_to_nothing_else():
    """A group meets the same noise whichever groups are driven with it."""
    spec = ObservationNoise(intensity=1.0)
    both, alone = observed(spec), observed(spec, names=("d e f",))
    assert torch.equal(both[:, 1], alone[:, 0])
    assert not torch.equal(both[:, 0], both[:, 1])
    assert not torch.equal(alone, observed(spec, names=("d e f",), seed=2))


def test_low_friction_bounds_the_acceleration():
    """0.2 · 9.81 = 1.962 m/s²."""
    made = sensing_and_control((LowFriction(intensity=0.2),), setting())
    state = torch.tensor([[[0.0, 10.0, -5.0], [0.0, 10.0, 5.0], [0.0, 10.0, 1.0]]])
    assert made.feasible_state(state)[0, :, 2].tolist() == pytest.approx([-1.962, 1.962, 1.0])
    assert torch.equal(made.observed_state(0, state), state)


def test_perturbations_add_up_in_their_order():
    made = sensing_and_control((Latency(intensity=0.2), Latency(intensity=0.2)), setting())
    out = [made.observed_state(k, torch.full((2, 3, 3), float(k))).flatten()[0].item() for k in range(4)]
    assert out == [-1, -1, 0, 1]
