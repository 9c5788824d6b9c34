"""The limits of a bottleneck over time, and the feedback that scales them, as pure functions of their settings."""

import numpy as np
import pytest

from cosim.spec.demand import Bottleneck, Fluctuation, Hold, Pulses
from cosim.traffic.bottleneck_limits import HeldSpeed, base_limits, pulse_limits

LANES = ("d_0", "d_1")
HOLD = Hold(edges=("e",), mean_speed=(10.0, 8.0), gain=0.5, integral_time=100, window=20, delay=30, start=60)


def bottleneck(**parts: object) -> Bottleneck:
    return Bottleneck(lanes=LANES, limits=(12.0, 9.0), **parts)  # pyright: ignore[reportArgumentType]


def test_without_fluctuation_the_limits_are_those_of_the_demand_intervals():
    limits = base_limits(bottleneck(), interval=100.0, seed=1, end=250.0)
    assert limits.shape == (251, 2)
    assert limits[[0, 99, 100, 250]].tolist() == [[12, 12], [12, 12], [9, 9], [9, 9]]


def test_the_fluctuation_has_the_stated_spread_duration_and_correlation():
    process = Fluctuation(sd=0.3, correlation_time=20, lane_correlation=0.6, lane_sd={"d_1": 0.1})
    limits = base_limits(bottleneck(fluctuation=process), interval=1e9, seed=1, end=40_000.0)
    logs = np.log(limits / 12.0)
    assert logs.mean(0) == pytest.approx([0, 0], abs=0.03)
    assert logs.std(0) == pytest.approx([0.3, 0.1], rel=0.1)
    assert np.corrcoef(logs.T)[0, 1] == pytest.approx(0.6, abs=0.07)
    later = np.corrcoef(logs[:-20, 0], logs[20:, 0])[0, 1]
    assert later == pytest.approx(np.exp(-1), abs=0.06)


def test_with_a_period_the_limits_swing():
    process = Fluctuation(sd=0.3, correlation_time=90, period=60)
    logs = np.log(base_limits(bottleneck(fluctuation=process), interval=1e9, seed=1, end=60_000.0)[:, 0])
    logs -= logs.mean()
    at = {lag: (logs[:-lag] * logs[lag:]).mean() / logs.var() for lag in (15, 30, 60)}
    assert at[15] == pytest.approx(0.0, abs=0.06)
    assert at[30] == pytest.approx(-np.exp(-1 / 3), abs=0.06)
    assert at[60] == pytest.approx(np.exp(-2 / 3), abs=0.06)
    assert logs.std() == pytest.approx(0.3, rel=0.1)


def test_limits_depend_on_the_seed_alone_and_begin_alike_for_every_duration():
    moving = bottleneck(fluctuation=Fluctuation(sd=0.3), pulses=Pulses(lanes=("d_1",), period_cv=0.3))
    for make in (lambda seed, end: base_limits(moving, 300.0, seed, end), lambda s, end: pulse_limits(moving, s, end)):
        assert np.array_equal(make(1, 500.0), make(1, 900.0)[:501])
        assert not np.array_equal(make(1, 900.0), make(2, 900.0))


def test_a_pulse_falls_lasts_and_rises_at_the_stated_rates():
    pulses = Pulses(lanes=("d_1",), limit=1.0, duration=10, period=100, first=20, falling=2, rising=0.5)
    allowed = pulse_limits(bottleneck(pulses=pulses), seed=1, end=150.0)
    assert np.isinf(allowed[:, 0]).all()
    assert allowed[[18, 19, 20, 30, 32, 34], 1].tolist() == [5.0, 3.0, 1.0, 1.0, 2.0, 3.0]
    assert allowed[120:131, 1].tolist() == [1.0] * 11  # the next one
    assert allowed[75, 1] == 1 + 0.5 * 45  # still rising, long above any limit


def factors(speeds: list[float], hold: Hold = HOLD) -> list[float]:
    held, found = HeldSpeed(hold, interval=1e9), []
    for speed in speeds:
        held.observe(20.0 * speed, 20.0)
        found.append(held.factor())
    return found


def test_too_fast_traffic_gets_lower_limits_and_too_slow_traffic_higher_ones():
    fast, slow, right = (factors([speed] * 200) for speed in (12.0, 8.0, 10.0))
    assert fast[:59] == [1.0] * 59  # before `start`
    assert all(factor < 1 for factor in fast[60:])
    assert fast[-1] < fast[100]  # the integral goes on
    assert all(factor > 1 for factor in slow[60:])
    assert right == [1.0] * 200
    assert factors([0.5] * 2000)[-1] == pytest.approx(HOLD.largest_factor)


def test_the_first_factor_by_hand():
    """60 s: e = 10/8 − 1 = .25; gain .5, and the first second of the integral, .25/100."""
    assert factors([8.0] * 60)[-1] == pytest.approx(np.exp(0.5 * 0.25 + 0.25 / 100))


def test_what_happens_within_the_delay_changes_nothing():
    rng = np.random.default_rng(0)
    speeds = rng.uniform(5, 15, 200).tolist()
    changed = speeds[:170] + [0.0] * 30
    assert factors(speeds) == factors(changed)
    assert factors([*speeds, *[0.0] * 31])[-1] != factors([*speeds, *[15.0] * 31])[-1]


def test_the_target_follows_the_demand_intervals():
    held, found = HeldSpeed(HOLD, interval=100.0), []
    for _ in range(150):
        held.observe(160.0, 20.0)  # 8 m/s: too slow in the first interval, right in the second
        found.append(held.factor())
    assert found[97] > found[-1] > 1.0  # only the integral is left
