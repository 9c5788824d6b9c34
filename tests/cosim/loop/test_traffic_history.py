"""Speeds and positions of all vehicles over the last seconds."""

import numpy as np
import pytest

from cosim.loop.traffic_history import TrafficHistory


def test_positions_are_sums_of_speeds_and_entering_vehicles_had_their_speed_before() -> None:
    history = TrafficHistory(5, 0.5)
    history.update(("a",), [4.0])
    history.update(("a",), [6.0])
    came, left = history.update(("a", "b"), [8.0, 10.0])
    assert (came, left) == (["b"], [])
    columns = np.array([history.column_of["a"], history.column_of["b"]])
    x, v = history.past(columns, 3)
    assert v.tolist() == [[4.0, 6.0, 8.0], [10.0, 10.0, 10.0]]
    assert x.tolist() == [[-7.0, -4.0, 0.0], [-10.0, -5.0, 0.0]]
    assert history.a[columns].tolist() == [4.0, 0.0]


def test_a_column_of_a_vehicle_that_left_has_nothing_of_it() -> None:
    history = TrafficHistory(4, 1.0)
    history.update(("a", "b"), [4.0, 5.0])
    assert history.update(("b",), [5.0]) == ([], ["a"])
    for k in range(200):
        history.update(("b", f"new{k}"), [5.0, 3.0])
        columns = np.array([history.column_of["b"], history.column_of[f"new{k}"]])
        x, v = history.past(columns, 4)
        assert v[1].tolist() == [3.0] * 4
        assert x[1].tolist() == pytest.approx([-9.0, -6.0, -3.0, 0.0])
        assert history.a[columns].tolist() == [0.0, 0.0]
    assert len(history.column_of) == 2
