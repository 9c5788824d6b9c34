"""Reference drivers in traffic: whom they brake for, and when."""

import numpy as np
import pytest

from cosim.loop.reference_reaction import ReferenceReaction
from gri.reference_drivers.drivers import DriverName
from tests.cosim.loop.near import near

CUT_IN = (14.0, 2.2, 8.0, -1.0)  # 9 m ahead, 0.2 m between the sides, 7 m/s slower
OWN = (0.0, 0.0, 15.0, 0.0)


def limits(name: DriverName, *others, steps: int = 8) -> list[float]:
    """The greatest acceleration of vehicle 0 in every step of 0.2 s, all vehicles at the same distance."""
    driver = ReferenceReaction(name, 1, 0.2)
    return [float(driver.limits(near(OWN, *others)).along[0, 0]) for _ in range(steps)]


@pytest.mark.parametrize("name", [DriverName.R157, DriverName.FSM, DriverName.RSS, DriverName.CAREFUL_HUMAN_WANDERING])
def test_a_cut_in_makes_it_brake_after_the_reaction_time(name):
    if name is DriverName.R157:
        found = limits(name, (10.0, 2.2, 8.0, -1.0))
        assert found == [np.inf] * 2 + [-6.0] * 6
    else:
        found = limits(name, CUT_IN)
        assert min(found[:4]) >= -0.4
        assert min(found) < -1.0


def test_the_careful_human_waits_for_the_overlap():
    assert limits(DriverName.CAREFUL_HUMAN, CUT_IN) == [np.inf] * 8
    assert min(limits(DriverName.CAREFUL_HUMAN, (14.0, 1.9, 8.0, -1.0))) < -1.0


def test_vehicles_that_stay_in_their_lane_or_behind_are_no_matter():
    for name in DriverName:
        assert limits(name, (14.0, 3.5, 8.0, 0.0), (-9.0, 0.0, 25.0, 0.0)) == [np.inf] * 8


def test_the_reaction_begins_anew_after_a_quiet_second():
    driver = ReferenceReaction(DriverName.R157, 1, 0.2)
    cut_in, alone = near(OWN, (10.0, 2.2, 8.0, -1.0)), near(OWN)
    sequence = [cut_in] * 3 + [alone] * 6 + [cut_in] * 3
    found = [float(driver.limits(now).along[0, 0]) for now in sequence]
    assert found == [np.inf, np.inf, -6.0] + [np.inf] * 8 + [-6.0]
