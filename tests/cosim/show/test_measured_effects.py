"""Explanations with a number: effects that are known by hand, and drives that are repeated bit by bit."""

import pandas as pd
import pytest
import torch

from cosim.runs.run import run
from cosim.runs.run_reading import read_tables
from cosim.show.action_effects import Drive, effect_of_vehicle, effect_since_takeover
from cosim.show.measured_effects import faithfulness, faithfulness_table, measured_effects
from cosim.spec.loading import load_scenario, override
from gri import checkpoint
from gri.core.edges import EdgeType
from gri.errors import InputError
from tests.cosim.show.test_action_effects import DT, START, ByHand, driven, in_one_lane


def test_the_stated_effect_over_a_time_is_known_by_hand():
    """Without the edge the jerk is 3 m/s³ greater: after T steps the speed differs by 3·Δt²·T(T − 1)/2."""
    policy = ByHand()
    drive = in_one_lane(driven(policy, {}, START))
    for steps in (1, 2, 10):
        wanted = -3.0 * DT**2 * steps * (steps - 1) / 2 / (steps * DT)
        assert effect_since_takeover(drive, policy, 1, 0, steps) == pytest.approx(wanted, abs=1e-5)
    assert effect_since_takeover(drive, policy, 2, 0, 10) == pytest.approx(0.0, abs=1e-9)


def test_a_vehicle_acts_by_way_of_others():
    """0 follows 1, which follows a slow 2: without 2 vehicle 1 is faster, and so is 0, which has no edge from 2."""
    policy, edges = checkpoint.load("us101_car_following"), {(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW}
    start = torch.tensor([[0.0, 15.0, 0.0], [20.0, 15.0, 0.0], [45.0, 8.0, 0.0]])
    states = driven(policy, edges, start)
    drive = Drive(states, states[:1].transpose(0, 1), [edges] * len(states))
    of_2, of_1 = (effect_of_vehicle(drive, policy, sender, [0, 1], 15) for sender in (2, 1))
    assert of_2[1] == pytest.approx(effect_since_takeover(drive, policy, 2, 1, 15))
    assert effect_since_takeover(drive, policy, 2, 0, 15) == pytest.approx(0.0, abs=1e-6)
    assert of_2[1] < of_2[0] < -0.05
    assert of_1[0] == pytest.approx(effect_since_takeover(drive, policy, 1, 0, 15))
    assert of_1[1] == pytest.approx(0.0, abs=1e-6)


def rows(*of: tuple[int, int, int, float, float]) -> pd.DataFrame:
    """Rows of (episode, receiver, sender, stated, measured without the vehicle)."""
    return pd.DataFrame(of, columns=["episode", "receiver", "sender", "stated_vehicle", "without_vehicle"])


def test_a_cause_is_right_if_nothing_else_changes_more():
    found = faithfulness(
        rows(
            (0, 0, 1, -1.0, -0.9), (0, 0, 2, 0.1, 0.2),  # named 1, and so it is; 1 is ahead
            (0, 1, 0, -0.4, -0.3), (0, 1, 2, 0.0, 0.6),  # named 0, but it was 2, which is ahead
            (1, 0, 1, 0.0, 0.0), (1, 0, 2, 0.3, 0.3),  # named 2, and so it is; 1 is ahead
            (1, 1, 0, 0.01, 0.9), (1, 1, 2, 0.02, 0.0),  # nothing is stated
        ),
        in_lane=True,
    )  # fmt: skip
    assert (found.vehicles, found.explained) == (4, 3)
    assert found.named.value == pytest.approx(2 / 3)
    assert found.vehicle_ahead.value == pytest.approx(2 / 3)
    assert found.random.value == pytest.approx(1 / 2)
    assert found.error.value == pytest.approx((0.1 + 0.1 + 0.0) / 3)
    table = faithfulness_table(found, 3.0)
    assert [line[1].split()[0] for line in table.lines] == ["67", "67", "50"]
    assert "3 of 4 driven vehicles" in table.note


def test_a_cause_without_any_measured_effect_is_wrong():
    found = faithfulness(rows((0, 0, 1, -1.0, 0.01), (0, 0, 2, 0.0, 0.0)), in_lane=False)
    assert (found.named.value, found.vehicle_ahead.value, found.random.value) == (0.0, 0.0, 0.0)


@pytest.mark.slow
def test_a_drive_is_repeated_as_it_was_and_its_edges_are_measured(tmp_path):
    scenario = load_scenario("us101_car_following", settings=["episodes=2", "traffic.warm_up=120"])
    run(scenario, folder=tmp_path / "run")
    tables = read_tables(tmp_path / "run")
    found = measured_effects(scenario, tables, 2.0, lambda *_: None, tmp_path)
    assert len(found) == 2 * 2 * 2
    assert found["same"].all()
    follows = found[found["edge"] == "follow"]
    assert (follows["stated"] - follows["without_edge"]).abs().max() < 0.02
    assert (found.loc[found["edge"] == "none", "without_edge"] == 0).all()
    with pytest.raises(InputError, match="wanted one without"):
        measured_effects(
            override(scenario, {"perturbations": [{"kind": "speed_offset", "intensity": 1}]}), tables, 2.0, print
        )
