"""The grid of cut-ins: golden counts of collisions, and what moves in it."""

import numpy as np
import pytest

from gri.errors import InputError
from gri.reference_drivers.cut_in_grid import (
    EGOS,
    GAPS,
    LATERALS,
    OTHERS,
    Grid,
    OtherCar,
    drive,
    drive_reference,
    usual_grid,
)
from gri.reference_drivers.drivers import DRIVERS, DriverName

LOW = {  # collisions by ego speed, made by independent code
    "r157": [74, 207, 395, 636, 940],
    "careful_human": [136, 367, 677, 1055, 1493],
    "rss": [9, 63, 150, 258, 400],
    "fsm": [17, 69, 151, 260, 404],
}
HIGH = {"r157": 2869, "careful_human": 3554, "rss": 1491, "fsm": 1649}


@pytest.mark.parametrize("name", LOW)
def test_golden_counts_of_the_slowest_egos(name):
    grid = Grid.of((20, 30), OTHERS["low"], GAPS["low"], LATERALS)
    hit = drive_reference(DRIVERS[DriverName(name)], grid).collided
    assert [int(hit[grid.ego == ego].sum()) for ego in (20, 30)] == LOW[name][:2]


@pytest.mark.slow
@pytest.mark.parametrize("name", LOW)
def test_golden_counts_of_both_grids(name):
    low, high = usual_grid("low"), usual_grid("high")
    assert (len(low), len(high)) == (15_930, 14_040)
    hit = drive_reference(DRIVERS[DriverName(name)], low).collided
    assert [int(hit[low.ego == ego].sum()) for ego in EGOS["low"]] == LOW[name]
    assert int(drive_reference(DRIVERS[DriverName(name)], high).collided.sum()) == HIGH[name]


def test_an_ego_that_never_reacts_collides_wherever_the_boxes_meet():
    grid = Grid.of((50,), (20,), (5, 20, 50), (0.0, 0.5, 1.5))
    still = drive(grid, lambda now, live: (np.zeros(len(live)), np.zeros(len(live), dtype=bool)))
    lateral_overlap = 1.6 / np.maximum(grid.lateral, 1e-9)  # [s] until the sides overlap
    passed = (grid.gap + 2 * 4.3) / (30 / 3.6)  # [s] until the ego is past
    assert still.collided.tolist() == (lateral_overlap < passed).tolist()
    assert (still.slowed == 0).all()


def test_the_other_reaches_its_lateral_speed_at_the_start_and_ends_in_front_of_the_ego():
    grid = Grid.of((50,), (20,), (10,), (0.0, 0.6, 1.5))
    path = OtherCar.of(grid)
    at_start = path.ramp
    assert path.across[at_start].tolist() == [3.5, 3.5, 3.5]
    assert path.speed[at_start].tolist() == [0.0, 0.6, 1.5]
    assert (path.across[0] >= 3.5).all()
    assert path.across[-1].tolist() == [3.5, 0.0, 0.0]
    assert np.diff(path.along, axis=0)[-1] == pytest.approx(20 / 36)


@pytest.mark.parametrize(
    ("ranges", "said"),
    [
        (((20,), (30,), (1,), (1,)), "slower than the ego"),
        (((20,), (10,), (0,), (1,)), "gap of 0"),
        ((range(20, 400), range(10, 400), range(1, 100), (1,)), "at most 1,000,000"),
        (((500,), (10,), (1,), (1,)), "above 400"),
    ],
)
def test_ranges_that_make_no_sense_are_refused(ranges, said):
    with pytest.raises(InputError, match=said):
        Grid.of(*ranges)
