"""The state predictor: exact where nothing unknown happens, and never told what it cannot know."""

import pytest
import torch

from cosim.perturb.sensing_and_control import RoundSetting, sensing_and_control
from cosim.spec.perturbations import ActionDelay, Dropout, LocalizationLatency, ObservationNoise, PerceptionLatency
from gri.core.dynamics import DUBINS, POINT_MASS_1D

DT = 0.2


def channels(*specs, dynamics=DUBINS, predicts=True, groups=2):
    """The channels of groups of three, of which a policy drives vehicles 0 and 1."""

    def straight(state):
        return torch.zeros(state.shape[:2])

    names = tuple(f"group {g}" for g in range(groups))
    return sensing_and_control(specs, RoundSetting(dynamics, DT, 60, 1, names, (0, 1), straight, predicts=predicts))


def driven(dynamics, jerks: float, steps: int = 12):
    """The states of two groups over time; `jerks` scales the random actions of all vehicles."""
    generator = torch.Generator().manual_seed(3)
    state = torch.rand(2, 3, len(dynamics.state), generator=generator, dtype=torch.float64) * 0.2
    state[..., dynamics.speed] += 12.0
    states = [state]
    for _ in range(steps):
        action = jerks * torch.randn(2, 3, len(dynamics.action), generator=generator, dtype=torch.float64)
        states.append(dynamics.step(states[-1], action, DT))
    return states


@pytest.mark.parametrize("dynamics", [DUBINS, POINT_MASS_1D])
@pytest.mark.parametrize("kind", [PerceptionLatency, LocalizationLatency])
def test_without_unknown_actions_the_prediction_is_the_present(dynamics, kind):
    made = channels(kind(intensity=0.4), dynamics=dynamics)
    for state in driven(dynamics, 0.0):
        shown = made.observed(state)
    assert torch.allclose(shown, state.expand_as(shown), atol=1e-9)


def test_a_vehicle_knows_its_own_place_by_dead_reckoning_but_not_what_others_decided():
    made = channels(PerceptionLatency(intensity=0.4), LocalizationLatency(intensity=0.6))
    for state in driven(DUBINS, 2.0):
        shown = made.observed(state)
    for view, role in ((0, 0), (1, 1)):
        assert torch.allclose(shown[view, :, role], state[:, role], atol=1e-9)
    others = (shown[0, :, 1:] - state[:, 1:])[..., DUBINS.speed].abs()
    assert others.min() > 0.001
    assert others.max() < 0.5, "they are off by what their unknown jerk does within 0.4 s"


@pytest.mark.parametrize("kind", [PerceptionLatency, LocalizationLatency])
def test_the_prediction_is_nearer_than_what_is_shown_without_one(kind):
    states, error = driven(DUBINS, 2.0), {}
    for predicts in (True, False):
        made = channels(kind(intensity=0.4), predicts=predicts)
        shown = [made.observed(state) for state in states][-1]
        error[predicts] = (shown - states[-1])[..., :2].abs().max()
    assert error[True] < 0.2 * error[False]


def test_asking_beforehand_changes_nothing():
    once, twice = (channels(LocalizationLatency(intensity=0.4)) for _ in range(2))
    for state in driven(DUBINS, 2.0):
        preview, first = twice.observed(state, final=False), once.observed(state)
        assert torch.equal(preview, first)
        assert torch.equal(twice.observed(state), first)


def test_a_predicted_vehicle_stops_and_does_not_reverse():
    made, state = channels(PerceptionLatency(intensity=0.6)), torch.zeros(2, 3, 6, dtype=torch.float64)
    state[..., DUBINS.speed], state[..., DUBINS.index("a")] = 1.0, -8.0
    shown = made.observed(state)
    assert (shown[0, :, 2, DUBINS.speed] == 0).all()


@pytest.mark.parametrize("specs", [(), (PerceptionLatency(intensity=0.4),)])
def test_lost_states_are_predicted_over_the_time_since_the_last_one(specs):
    """Without unknown actions, what was seen last says all; a driven vehicle has felt its own."""
    for jerks, roles in ((0.0, slice(None)), (2.0, slice(0, 2))):
        made = channels(Dropout(intensity=0.8), *specs)
        for step, state in enumerate(driven(DUBINS, jerks, steps=20)):
            shown = made.observed(state)
            for view in range(made.views if step > 1 else 0):  # before, they are those from before the first one
                known = roles if jerks == 0 or made.views == 1 else slice(view, view + 1)
                assert torch.allclose(shown[view, :, known], state[:, known], atol=1e-9)
        without = channels(Dropout(intensity=0.8), *specs, predicts=False)
        shown = [without.observed(state) for state in driven(DUBINS, jerks, steps=20)][-1]
        assert (shown - state).abs().max() > 1.0


@pytest.mark.parametrize("dynamics", [DUBINS, POINT_MASS_1D])
def test_whose_actions_come_late_is_shown_where_it_will_be_when_they_come(dynamics):
    """By its own actions exactly; others go on as they do. Its first actions come after as many steps without one."""
    made, generator, steps = (
        channels(ActionDelay(intensity=0.6), dynamics=dynamics),
        torch.Generator().manual_seed(1),
        3,
    )
    state, shown, states = driven(dynamics, 0.0, steps=0)[0], [], []
    for _ in range(12):
        states.append(state)
        shown.append(made.observed(state)[0])
        action = torch.randn(2, 3, len(dynamics.action), generator=generator, dtype=torch.float64)
        action[:, 2] = 0.0
        state = dynamics.step(state, made.executed_action(action), DT)
    for predicted, later in zip(shown, states[steps:], strict=False):
        assert torch.allclose(predicted, later, atol=1e-9)
    assert not torch.allclose(shown[0], states[0])


def test_states_that_come_in_time_are_shown_as_they_are():
    assert channels(ObservationNoise(intensity=0.5)).predictor is None
    assert channels(PerceptionLatency(intensity=0.4), predicts=False).predictor is None
