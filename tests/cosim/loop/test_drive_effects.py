"""Measured against stated effects in real traffic, kind by kind, and nothing measured where nothing is done."""

import msgspec
import numpy as np
import pytest

from cosim.perturb.effects import effects_table
from cosim.spec.perturbations import KINDS
from cosim.world.episode import COLUMNS
from gri.core.policy import ConstantVelocity, IntelligentDriver

A, HEADING, V = (COLUMNS.index(name) for name in ("a", "heading", "v"))
IDM = IntelligentDriver(0.2)
KIND_AND_TOLERANCE = [
    ("headway_ratio", 0.3, 0.01),
    ("headway_metres", 2.0, 0.01),
    ("speed_offset", 2.0, 0.01),
    ("remove_third", 0.2, 0.01),
    ("leader_braking", 3.0, 0.01),
    ("observation_noise", 0.5, 0.1),
    ("dropout", 0.4, 0.1),
    ("perception_latency", 0.4, 0.001),
    ("localization_latency", 0.4, 0.001),
    ("action_noise", 2.0, 0.15),
    ("action_delay", 0.4, 0.001),
]


@pytest.fixture(scope="module")
def scenario(short_scenario):
    return msgspec.structs.replace(short_scenario, episodes=3, watch=0.0, time_limit=200.0)


def reached(scenario, simulate, policy, **perturbations):
    specs = tuple(KINDS[kind](intensity=intensity) for kind, intensity in perturbations.items())
    outcome = simulate(msgspec.structs.replace(scenario, perturbations=specs), policy)
    assert outcome.episodes
    return effects_table(outcome.effects).set_index("quantity"), outcome


@pytest.mark.parametrize(("kind", "intensity", "tolerance"), KIND_AND_TOLERANCE)
def test_each_perturbation_reaches_what_it_states(scenario, simulate, kind, intensity, tolerance):
    found, outcome = reached(scenario, simulate, IDM, **{kind: intensity})
    assert (found["perturbation"] == kind).all()
    assert (found["groups"] == len(outcome.episodes)).all()
    scale = max(abs(intensity), 1e-3)
    np.testing.assert_allclose(found["measured"], found["stated"], atol=tolerance * scale)
    assert (found["stated"] != found["unperturbed"]).any()


UNDISTURBED_TOO = ("remove_third", "leader_braking")  # at 0 vehicle 2 still vanishes; a leader brakes by itself, too


@pytest.mark.parametrize("kind", [kind for kind, _, _ in KIND_AND_TOLERANCE if kind not in UNDISTURBED_TOO])
def test_at_the_neutral_intensity_nothing_is_measured(scenario, simulate, kind):
    found, _ = reached(scenario, simulate, IDM, **{kind: KINDS[kind].neutral})
    np.testing.assert_allclose(found["measured"], 0.0, atol=1e-5)


def test_a_neighbour_that_cuts_in_reaches_the_lane_and_its_speed(scenario, simulate):
    longer = msgspec.structs.replace(scenario, horizon=5.0)
    found, _ = reached(longer, simulate, IDM, neighbour_cut_in=1.0)
    assert found.loc["offset after the lane change", "measured"] < 0.1
    assert found.loc["speed below the follower's", "measured"] >= 0.99  # a slower neighbour keeps its speed


def test_displaced_groups_that_sumo_drives_start_where_they_are_put(scenario, simulate):
    found, _ = reached(scenario, simulate, None, headway_ratio=0.3)
    assert found["measured"].tolist() == pytest.approx([0.3], abs=1e-3)


def test_the_friction_circle_holds_in_the_recorded_drive(scenario, simulate):
    """A policy that brakes at once by 20 m/s³ stays within μ·g on a straight road, and it would not have."""

    class Jerky(ConstantVelocity):
        def act(self, memory, state):
            return super().act(memory, state)[0] - 20.0, memory

    found, outcome = reached(scenario, simulate, Jerky(0.2), low_friction=0.3)
    (row,) = found.to_dict("records")
    limit = 0.3 * 9.81
    assert row["stated"] == pytest.approx(limit)
    assert row["measured"] <= limit + 1e-9
    assert row["unperturbed"] > limit + 1
    for episode in outcome.episodes:
        driven = episode.driven
        assert np.abs(episode.state[driven][:, A]).max() <= limit + 1e-9
