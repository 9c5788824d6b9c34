"""Braking and jerk after the hand-back as columns of a table."""

import math

import numpy as np
import pytest

from cosim.world.episode import COLUMNS, Ending, Episode
from cosim.world.groups import Group
from cosim.world.hand_back_columns import hand_back_columns
from cosim.world.surroundings import Surroundings

END = 2.0


def episode(acceleration: dict[tuple[float, int], float], until: float = 14.0, **changes) -> Episode:
    """A group that was driven until 2 s, with these accelerations [m/s²] by (time, role) and 0 elsewhere."""
    time = np.round(np.arange(0, until + 0.1, 0.2), 10)
    state = np.zeros((len(time), 3, len(COLUMNS)))
    for (at, role), a in acceleration.items():
        state[np.abs(time - at) < 1e-6, role, COLUMNS.index("a")] = a
    facts = {
        "driver": "gri",
        "group": Group(("a", "b", "c"), 0.4),
        "time": time,
        "state": state,
        "valid": np.ones((len(time), 3), dtype=bool),
        "driven": np.zeros((len(time), 3), dtype=bool),
        "length": np.full(3, 5.0),
        "width": np.full(3, 1.8),
        "order": (0, 1, 2),
        "graph": None,
        "graph_time": np.empty(0),
        "ending": Ending.HORIZON,
        "end": END,
        "events": (),
        "surroundings": Surroundings(("a",), np.zeros(1, int), np.ones(1), np.zeros((1, 7)), np.ones(1), np.ones(1)),
    }
    return Episode(**(facts | changes))


def test_braking_counts_for_five_seconds_and_jerk_for_ten():
    braking = {(END, 0): -9.0, (7.0, 1): -3.0, (7.2, 1): -4.0, (12.2, 0): -8.0}
    columns = hand_back_columns(episode(braking))
    assert columns["braking_after"] == 3.0  # not that of the drive, nor that after 5 s
    assert columns["jerk_after"] == pytest.approx(45.0)  # from the last driven instant on; not that after 10 s


def test_only_driven_vehicles_that_are_there_count():
    braking = {(3.0, 2): -5.0, (4.0, 1): -4.0, (5.0, 0): -2.0}
    assert hand_back_columns(episode(braking))["braking_after"] == 4.0
    assert hand_back_columns(episode(braking, judged_roles=(0,)))["braking_after"] == 2.0
    valid = np.ones((71, 3), dtype=bool)
    valid[20:, 1] = False
    assert hand_back_columns(episode(braking, valid=valid))["braking_after"] == 2.0


def test_no_watch_is_not_a_soft_hand_back():
    columns = hand_back_columns(episode({}, until=END))
    assert all(math.isnan(value) for value in columns.values())
    assert hand_back_columns(episode({}))["braking_after"] == 0.0
