"""The vehicles around a group, by hand."""

import numpy as np
import pytest

from cosim.world.snapshot import Snapshot
from cosim.world.surroundings import REACH, Surroundings


def snapshot(time: float, **s: float) -> Snapshot:
    """Vehicles at these positions along the x axis."""
    along, n = np.array([*s.values()]), np.ones(len(s))
    xy = np.stack([along, 0 * n], axis=1)
    return Snapshot(time, tuple(s), xy, 0 * n, 10 * n, 0 * n, along, 0 * n, 5 * n, 1.8 * n, ("e_0",) * len(s))


TRAFFIC = Surroundings.of([snapshot(1.0, a=0.0, b=100.0), snapshot(2.0, b=110.0, c=300.0), snapshot(3.0)])


def test_every_vehicle_of_every_instant_is_a_row():
    assert [TRAFFIC.ids[k] for k in TRAFFIC.vehicle] == ["a", "b", "b", "c"]
    assert TRAFFIC.time.tolist() == [1, 1, 2, 2]
    assert TRAFFIC.feature("s").tolist() == [0, 100, 110, 300]
    assert TRAFFIC.length.tolist() == [5] * 4


@pytest.mark.parametrize(("beyond", "names"), [(-1e-3, ["a", "b", "b", "c"]), (1e-3, ["b", "b"])])
def test_near_is_within_reach_of_the_rearmost_and_the_foremost_vehicle_at_that_instant(beyond, names):
    time, reach = np.array([0.0, 1.0, 2.0]), REACH + beyond
    s = np.array([[500.0, 500.0], [reach, reach + 1.0], [140.0, 300.0 - reach]])
    found = TRAFFIC.near(time, s, 1.0, 2.0)
    assert [found.ids[k] for k in found.vehicle] == names


def test_near_begins_and_ends_when_it_is_told():
    time, s = np.array([1.0, 2.0]), np.array([[100.0], [110.0]])
    assert TRAFFIC.near(time, s, 2.0, 2.0).time.tolist() == [2.0]
    assert TRAFFIC.near(time, s, 1.0, 1.9).time.tolist() == [1.0, 1.0]
    assert len(TRAFFIC.near(time, s, 3.0, 9.0)) == 0
