"""Headways that are found, and the braking that is needed, behind another vehicle."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.measures.following import Ahead, required_braking


def test_required_braking_is_that_of_school_physics():
    assert required_braking(10.0, None) == 0.0
    assert required_braking(10.0, Ahead(0.0, 5.0, 0.0)) == math.inf
    assert required_braking(10.0, Ahead(21.0, 5.0, 0.0)) == pytest.approx(25 / 40)  # 20 m for 5 m/s
    assert required_braking(10.0, Ahead(21.0, 0.0, 0.0)) == pytest.approx(100 / 40)  # a standing vehicle
    assert required_braking(10.0, Ahead(21.0, 10.0, -5.0)) == pytest.approx(100 / 60)  # it stops 10 m farther on
    assert required_braking(10.0, Ahead(21.0, 12.0, 0.0)) == 0.0


speeds = st.floats(0, 40)


@given(v=speeds, gap=st.floats(1.5, 100), leader=speeds, braking=st.floats(0, 9))
def test_the_required_braking_is_enough(v, gap, leader, braking):
    """Both brake as constantly as stated: the gap never falls below the clearance of 1 m, up to the step's error."""
    ahead = Ahead(gap, leader, -braking)
    mine, step = required_braking(v, ahead), 0.01
    time = np.arange(0, 60, step)

    def way(speed: float, by: float) -> np.ndarray:
        return np.cumsum(np.maximum(speed - by * time, 0.0)) * step

    least = (gap + way(leader, braking) - way(v, mine)).min() if mine or v <= leader else gap
    assert least > min(1.0, 0.5 * gap) - 0.5
