"""The time from a risk to the brake, and how the brake is pressed."""

import numpy as np
import pytest

from gri.reference_drivers.drivers import DRIVERS, DriverName, Judgement, ReferenceDriver
from gri.reference_drivers.reaction import Reaction, react


def brakes(driver: ReferenceDriver, risks: list[bool], braking: float = 7.0) -> list[float]:
    """The decelerations at 10 Hz under a sequence of risks."""
    memory, found = Reaction.none(1), []
    for risk in risks:
        judged = Judgement(np.array([risk]), np.array([braking]), np.array([False]))
        deceleration, memory = react(driver, judged, memory, 0.1)
        found.append(round(float(deceleration[0]), 3))
    return found


@pytest.mark.parametrize(("name", "steps"), [("r157", 4), ("rss", 8), ("fsm", 8)])
def test_nothing_happens_during_the_reaction_time(name, steps):
    found = brakes(DRIVERS[DriverName(name)], [True] * 12)
    assert found[:steps] == [0.0] * steps
    assert found[steps] > 0


def test_the_careful_human_lifts_the_foot_and_then_brakes_at_once_or_after_judging():
    release = DRIVERS[DriverName.CAREFUL_HUMAN]
    assert brakes(release, [True] * 10) == [0.4] * 8 + [1.665, 2.93]
    wandering = DRIVERS[DriverName.CAREFUL_HUMAN_WANDERING]
    assert brakes(wandering, [True] * 13) == [0.0] * 4 + [0.4] * 8 + [1.665]


def test_a_risk_that_goes_away_stops_the_clock_of_the_reaction():
    driver = DRIVERS[DriverName.R157]
    assert brakes(driver, [True, True, False, True, True, True]) == [0.0, 0.0, 0.0, 0.0, 0.0, 7.0]


def test_forgetting_begins_a_new_reaction():
    memory = Reaction(np.ones(2), np.ones(2), np.full(2, 5.0), np.ones(2, dtype=bool))
    left = memory.forgotten(np.array([True, False]))
    assert left.waited.tolist() == [0, 1]
    assert left.braking.tolist() == [0, 5]
    assert left.alert.tolist() == [False, True]
