"""The speed limits of a bottleneck over time, lane by lane, as arrays; and the feedback that scales them.

What a limit is made of, in this order: the limit of the demand interval, times a fluctuation of its own for each lane,
times the factor of the feedback (`Hold`), and at most what a pulse allows. All random numbers come from the seed.
"""

import cmath
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from cosim.spec.demand import Bottleneck, Fluctuation, Hold, Pulses

PERIOD = 1.0  # [s] between two changes of the limits
LOWEST = 0.1  # [m/s]
_STREAM = 0x11317  # separates these random numbers from those of the demand


def base_limits(bottleneck: Bottleneck, interval: float, seed: int, end: float) -> Float[np.ndarray, "times lanes"]:
    """The limits [m/s] every PERIOD from t = 0 to `end` [s], without feedback and pulses."""
    times = np.arange(math.floor(end / PERIOD) + 1) * PERIOD
    numbers = np.minimum((times // interval).astype(int), len(bottleneck.limits) - 1)
    level = np.array(bottleneck.limits)[numbers][:, None] * np.ones(len(bottleneck.lanes))
    return level if bottleneck.fluctuation is None else level * _fluctuation(bottleneck, seed, len(times))


def pulse_limits(bottleneck: Bottleneck, seed: int, end: float) -> Float[np.ndarray, "times lanes"]:
    """What the pulses allow [m/s] at the times of `base_limits`; infinite where there is none."""
    times = np.arange(math.floor(end / PERIOD) + 1) * PERIOD
    allowed = np.full((len(times), len(bottleneck.lanes)), np.inf)
    if bottleneck.pulses is not None:
        for lane, stream in zip(bottleneck.pulses.lanes, _streams(seed, 1, len(bottleneck.pulses.lanes)), strict=True):
            allowed[:, bottleneck.lanes.index(lane)] = _pulses(bottleneck.pulses, times, stream)
    return allowed


def _streams(seed: int, kind: int, number: int) -> list[np.random.Generator]:
    return [np.random.default_rng(s) for s in np.random.SeedSequence([seed, _STREAM, kind]).spawn(number)]


def _fluctuation(bottleneck: Bottleneck, seed: int, number: int) -> Float[np.ndarray, "times lanes"]:
    """Log-normal factors with the median 1: a Gaussian process in the logarithm, exact at each step."""
    process = bottleneck.fluctuation
    assert process is not None, "the caller has one"
    lanes = len(bottleneck.lanes)
    together, *own = _streams(seed, 0, lanes + 1)
    common = _stationary(together, process, number)
    alone = np.stack([_stationary(stream, process, number) for stream in own], axis=1)
    mixed = math.sqrt(process.lane_correlation) * common[:, None] + math.sqrt(1 - process.lane_correlation) * alone
    spread = np.array([process.lane_sd.get(lane, process.sd) for lane in bottleneck.lanes])
    return np.exp(spread * mixed)


def _stationary(rng: np.random.Generator, process: Fluctuation, number: int) -> Float[np.ndarray, " times"]:
    """A stationary Gaussian process with mean 0, variance 1 and the autocorrelation exp(−t/T)·cos(2πt/P).

    T is the correlation time, P the period; without a period the cosine is 1. It is the real part of a complex
    Ornstein-Uhlenbeck process.
    """
    turn = 0.0 if process.period is None else 2 * math.pi * PERIOD / process.period
    keep = cmath.exp(complex(-PERIOD / process.correlation_time, turn))
    shocks = rng.standard_normal((number, 2)) @ np.array([1.0, 1.0j])
    shocks[1:] *= math.sqrt(1 - abs(keep) ** 2)
    values = np.empty(number)
    last = 0j
    for k, shock in enumerate(shocks.tolist()):
        last = keep * last + shock
        values[k] = last.real
    return values


def _pulses(pulses: Pulses, times: Float[np.ndarray, " times"], rng: np.random.Generator) -> np.ndarray:
    """The least of all pulses: the limit falls and rises at the given rates before and after each of them."""
    allowed = np.full(len(times), np.inf)
    start = pulses.first
    while start < times[-1]:
        before = pulses.limit + pulses.falling * (start - times)
        after = pulses.limit + pulses.rising * (times - start - pulses.duration)
        allowed = np.minimum(allowed, np.maximum(np.maximum(before, after), pulses.limit))
        start += pulses.period * math.exp(pulses.period_cv * float(rng.standard_normal()))
    return allowed


class HeldSpeed:
    """A proportional-integral feedback on the mean speed of the study area; its output is a factor on the limits.

    The factor is exp(gain · e + ∫ e dt / integral_time), where e is the relative error of the mean speed between
    `delay + window` and `delay` [s] ago. Nothing that happens during the last `delay` changes it: so a drive that is
    no longer than that leaves the limits as they are in the undisturbed traffic.
    """

    def __init__(self, hold: Hold, interval: float) -> None:
        self._hold, self._interval = hold, interval
        self._speeds: list[tuple[float, float]] = []  # sum of speeds, number of vehicles, every PERIOD
        self._integral = 0.0

    def observe(self, speed_sum: float, vehicles: float) -> None:
        """The sum of the speeds [m/s] of the vehicles in the study area, and their number; once per PERIOD."""
        self._speeds.append((speed_sum, vehicles))

    def factor(self) -> float:
        """The factor on the limits for the next PERIOD; call it once per observation."""
        hold, now = self._hold, len(self._speeds) * PERIOD
        last = round((now - hold.delay) / PERIOD)
        first = max(last - round(hold.window / PERIOD), 0)
        if now < hold.start or last <= first:
            return 1.0
        speeds, vehicles = np.sum(self._speeds[first:last], axis=0)
        if not vehicles:
            return math.exp(self._integral)
        error = float(np.clip(self._target(now) / (speeds / vehicles) - 1, -hold.largest_error, hold.largest_error))
        most = math.log(hold.largest_factor)
        self._integral = float(np.clip(self._integral + error * PERIOD / hold.integral_time, -most, most))
        return math.exp(float(np.clip(hold.gain * error + self._integral, -most, most)))

    def _target(self, time: float) -> float:
        speeds: Sequence[float] = self._hold.mean_speed
        return speeds[min(int(time // self._interval), len(speeds) - 1)]
