"""Perturbed observations and actions, by hand and statistically."""

import pytest
import torch

from cosim.perturb.sensing_and_control import RoundSetting, sensing_and_control
from cosim.spec.perturbations import (
    ActionDelay,
    ActionNoise,
    Dropout,
    HeadwayRatio,
    LocalizationLatency,
    LowFriction,
    ObservationNoise,
    PerceptionLatency,
)
from gri.core.dynamics import DUBINS, POINT_MASS_1D


def setting(dynamics=POINT_MASS_1D, names=("a b c", "d e f"), seed=1, steps=400, curvature=0.0):
    def bend(state):
        return torch.full(state.shape[:2], curvature, dtype=torch.float64)

    return RoundSetting(dynamics, 0.2, steps, seed, names, (0, 1), bend)


def through(spec, states, **options):
    """What the observation channel of a perturbation shows of these states, and the channels."""
    made = sensing_and_control((spec,) if not isinstance(spec, tuple) else spec, setting(**options))
    return torch.stack([made.observed(state) for state in states]), made


def ramp(count=8, dynamics=POINT_MASS_1D, groups=2):
    """The k-th state of everything is k."""
    shape = (groups, 3, len(dynamics.state))
    return [torch.full(shape, float(k), dtype=torch.float64) for k in range(count)]


def driving(count=60, dynamics=POINT_MASS_1D, groups=2):
    """Vehicles that speed up slowly, so that each state differs from every other one."""
    time = 0.2 * torch.arange(count, dtype=torch.float64)
    state = torch.zeros(count, groups, 3, len(dynamics.state), dtype=torch.float64)
    state[..., 0] = (10 * time + 0.1 * time**2)[:, None, None] + 20 * torch.arange(3)
    state[..., dynamics.speed] = (10 + 0.2 * time)[:, None, None]
    return list(state)


def reached(made, group=0):
    return {effect.quantity: effect for effect in made.effects(group, 10)}


def test_other_perturbations_leave_the_channels_as_they_are():
    made = sensing_and_control((HeadwayRatio(intensity=0.5),), setting())
    state, action = torch.ones(2, 3, 3), torch.ones(2, 3, 1)
    assert torch.equal(made.observed(state), state[None])
    assert made.executed_action(action) is action
    assert made.feasible_state(state) is state
    assert made.effects(0, 5) == []


@pytest.mark.parametrize(
    "spec",
    [
        ObservationNoise(intensity=0.0),
        Dropout(intensity=0.0),
        PerceptionLatency(intensity=0.0),
        LocalizationLatency(intensity=0.0),
        ActionNoise(intensity=0.0),
        ActionDelay(intensity=0.0),
    ],
    ids=lambda spec: spec.kind,
)
def test_nothing_is_done_and_nothing_measured_at_intensity_zero(spec):
    """The negative control: bit for bit the same, and every measured effect is 0."""
    states = driving()
    shown, made = through(spec, states)
    action = torch.randn(2, 3, 1)
    assert (shown == torch.stack(states)[:, None]).all()
    assert torch.equal(made.executed_action(action), action)
    made.executed_action(2 * action)
    assert all(effect.stated == effect.measured == 0 for effect in made.effects(0, 10))
    assert made.effects(0, 10)


def test_others_are_perceived_late_and_the_own_vehicle_at_once():
    """0.4 s are two steps. View 0 is that of vehicle 0, view 1 that of vehicle 1."""
    shown, made = through(PerceptionLatency(intensity=0.4), ramp())
    assert made.view_of == (0, 1, 0)
    for view, (own, *others) in enumerate(((0, 1, 2), (1, 0, 2))):
        assert shown[:, view, 0, own, 0].tolist() == [0, 1, 2, 3, 4, 5, 6, 7]
        for other in others:
            assert shown[2:, view, 0, other, 0].tolist() == [0, 1, 2, 3, 4, 5]


def test_the_own_position_is_late_and_others_are_perceived_at_once():
    shown, _ = through(LocalizationLatency(intensity=0.4), ramp())
    for view, (own, *others) in enumerate(((0, 1, 2), (1, 0, 2))):
        assert shown[2:, view, 0, own, 0].tolist() == [0, 1, 2, 3, 4, 5]
        assert shown[:, view, 0, own, 2].tolist() == [0, 1, 2, 3, 4, 5, 6, 7]  # its acceleration it feels
        for other in others:
            assert (shown[:, view, 0, other] == torch.arange(8.0, dtype=torch.float64)[:, None]).all()


def test_both_latencies_show_the_whole_group_late():
    both = (PerceptionLatency(intensity=0.4), LocalizationLatency(intensity=0.4))
    shown, made = through(both, ramp())
    assert (shown[2:, ..., 0] == torch.arange(6.0, dtype=torch.float64)[:, None, None, None]).all()
    assert [effect.measured for effect in made.effects(0, 10)] == pytest.approx([0.4, 0.4])


def test_before_the_first_observation_a_vehicle_moved_on_steadily():
    """Otherwise an encoder would see it stand still, and then drive."""
    shown, _ = through(PerceptionLatency(intensity=1.0), driving())
    x, v = shown[:, 0, 0, 2, 0], shown[:, 0, 0, 2, 1]
    assert (x.diff() > 1.9).all()
    assert (v[:6] == 10.0).all()


@pytest.mark.parametrize("kind", [PerceptionLatency, LocalizationLatency])
def test_the_measured_delay_is_the_stated_one(kind):
    for seconds in (0.2, 0.6, 1.0):
        _, made = through(kind(intensity=seconds), driving())
        assert reached(made)["delay"].measured == pytest.approx(seconds)
    _, made = through(kind(intensity=0.35), driving())
    assert reached(made)["delay"].measured == pytest.approx(0.4)  # whole steps: the table shows the difference


def test_a_driver_knows_its_own_acceleration_and_yaw_rate_at_once():
    states = ramp(dynamics=DUBINS)
    found, _ = through(Dropout(intensity=1.0), states, dynamics=DUBINS)
    now = torch.arange(8.0, dtype=torch.float64)
    for role in (0, 1):
        own = found[:, 0, 0, role, [DUBINS.index("a"), DUBINS.index("yaw_rate")]]
        assert torch.equal(own, now[:, None].expand(8, 2))
        assert (found[1:, 0, 0, role, : DUBINS.index("a")] < now[1:, None]).all()
    assert (found[1:, 0, 0, 2] == 0).all()  # of the vehicle that it does not drive it knows nothing more


def test_delayed_actions_begin_with_none():
    made = sensing_and_control((ActionDelay(intensity=0.6),), setting())
    out = [made.executed_action(torch.full((2, 3, 1), 7.0 + k)).flatten()[0].item() for k in range(12)]
    assert out[:5] == [0, 0, 0, 7, 8]
    assert reached(made)["delay"].measured == pytest.approx(0.6)


def test_dropout_holds_what_was_seen_last():
    found, made = through(Dropout(intensity=0.5), ramp(400))
    found = found[:, 0]
    step = found[1:] - found[:-1]
    current = torch.arange(400.0, dtype=torch.float64)[:, None, None] - found[..., 0]
    assert (found[0] == 0).all()
    assert (step >= 0).all()  # never older than what was shown before
    share = (current[1:] > 0).double().mean().item()
    assert share == pytest.approx(0.5, abs=0.04)
    assert reached(made)["share of missing states"].measured == pytest.approx((current[1:, 0] > 0).double().mean())
    assert (found[..., 0] == found[..., 1]).all()  # position and speed are observed together or not at all


def test_dropout_of_everything_shows_the_first_state_for_ever():
    found, made = through(Dropout(intensity=1.0), ramp())
    assert (found[..., :2] == 0).all()
    assert reached(made)["share of missing states"].measured == 1


def test_observation_noise_has_its_standard_deviations():
    states = [torch.zeros(2, 3, 6, dtype=torch.float64)] * 400
    found, made = through(ObservationNoise(intensity=2.0), states, dynamics=DUBINS)
    expected = {"x": 2.0, "y": 0.4, "v": 1.0, "heading": 0.0, "a": 0.0, "yaw_rate": 0.0}
    for name, sigma in expected.items():
        assert found[..., DUBINS.index(name)].std().item() == pytest.approx(sigma, rel=0.06)
    assert abs(found[..., 0].mean().item()) < 0.15
    for quantity, sigma in (("error along the road", 2), ("error across the road", 0.4), ("error of speed", 1)):
        assert reached(made)[quantity].measured == pytest.approx(sigma, rel=0.08)


def test_action_noise_has_its_standard_deviations():
    made = sensing_and_control((ActionNoise(intensity=3.0),), setting(DUBINS))
    out = torch.stack([made.executed_action(torch.zeros(2, 3, 2)) for k in range(400)])
    assert out[..., 0].std().item() == pytest.approx(3.0, rel=0.06)
    assert out[..., 1].std().item() == pytest.approx(0.06, rel=0.06)
    assert reached(made)["error of jerk"].measured == pytest.approx(3.0, rel=0.08)
    assert reached(made)["error of yaw acceleration"].measured == pytest.approx(0.06, rel=0.08)


def test_noise_belongs_to_the_group_and_the_seed_and_to_nothing_else():
    """A group meets the same noise whichever groups are driven with it."""
    spec = ObservationNoise(intensity=1.0)
    both, alone = through(spec, ramp())[0], through(spec, ramp(groups=1), names=("d e f",))[0]
    assert torch.equal(both[:, :, 1], alone[:, :, 0])
    assert not torch.equal(both[:, :, 0], both[:, :, 1])
    assert not torch.equal(alone, through(spec, ramp(groups=1), names=("d e f",), seed=2)[0])


def test_a_preview_changes_nothing_and_shows_what_the_next_call_will():
    made = sensing_and_control((ObservationNoise(intensity=1.0), PerceptionLatency(intensity=0.4)), setting())
    for state in ramp():
        previewed = made.observed(state, final=False)
        assert torch.equal(previewed, made.observed(state))


def test_low_friction_bounds_the_acceleration():
    """0.2 · 9.81 = 1.962 m/s²."""
    made = sensing_and_control((LowFriction(intensity=0.2),), setting())
    state = torch.tensor([[[0.0, 10.0, -5.0], [0.0, 10.0, 5.0], [0.0, 10.0, 1.0]]], dtype=torch.float64)
    assert made.feasible_state(state)[0, :, 2].tolist() == pytest.approx([-1.962, 1.962, 1.0])
    assert torch.equal(made.observed(state)[0], state)
    (effect,) = made.effects(0, 1)
    assert (effect.stated, effect.measured, effect.unperturbed) == pytest.approx((1.962, 1.962, 5.0))


@pytest.mark.parametrize("curvature", [0.0, 0.004, -0.004])
def test_low_friction_is_a_circle(curvature):
    """√(a² + (v·(ω + v·κ))²) ≤ μ·g, whatever is demanded; what is inside stays as it is."""
    made = sensing_and_control((LowFriction(intensity=0.3),), setting(DUBINS, curvature=curvature))
    generator = torch.Generator().manual_seed(1)
    state = torch.rand(2, 3, 6, generator=generator, dtype=torch.float64) * torch.tensor([9, 9, 20, 0, 12, 0.8])
    state[..., 4:] -= torch.tensor([6, 0.4])
    out = made.feasible_state(state)
    v, a, yaw = out[..., 2], out[..., 4], out[..., 5]
    total = torch.hypot(a, v * (yaw + v * curvature))
    demanded = torch.hypot(state[..., 4], v * (state[..., 5] + v * curvature))
    limit = 0.3 * 9.81
    assert (total <= limit + 1e-9).all()
    assert total[demanded > limit] == pytest.approx(limit)
    assert (demanded > limit).any()
    assert torch.equal(out[demanded <= limit], state[demanded <= limit])
    assert torch.equal(out[..., :4], state[..., :4])


def test_on_a_bend_a_vehicle_in_its_lane_can_brake_less():
    """In one lane at 20 m/s on a radius of 250 m: 1.6 m/s² across leave √(1.962² − 1.6²) = 1.1355 m/s² along."""
    made = sensing_and_control((LowFriction(intensity=0.2),), setting(curvature=0.004))
    state = torch.tensor([[[0.0, 20.0, -5.0]] * 3], dtype=torch.float64)
    assert made.feasible_state(state)[0, 0, 2].item() == pytest.approx(-1.1355, abs=1e-3)


def test_perturbations_add_up_in_their_order():
    twice = (PerceptionLatency(intensity=0.2), PerceptionLatency(intensity=0.2))
    shown, _ = through(twice, ramp())
    assert shown[2:, 0, 0, 2, 0].tolist() == [0, 1, 2, 3, 4, 5]
