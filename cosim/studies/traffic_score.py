"""One score for simulated traffic: how probable a recording is under it, and whether it lives as the recording does.

After the metric of the Waymo Sim Agents challenge (Montali et al., 2023), for freeways. A histogram of each quantity is
made of the simulated samples, and the likelihood that it gives to each recorded sample is averaged in the logarithm. It
is told as a share of the likelihood that the recording's own histogram gives: 1 means that both are equal. The ceiling
is the share that another part of the recording reaches. What histograms of single samples cannot see is told beside:
spread within lanes and vehicles, lane changes, standing traffic, how long speeds last, and how fast waves travel.

Two rows need no simulation. `constant_traffic` has every vehicle at the mean of the recording; `uniform` is a histogram
with the same probability in all bins. A simulation that does not beat them is worth nothing.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.stats import t

from cosim.studies.wave_speed import wave_speed
from cosim.studies.window_statistics import LAGS, SUMS

PSEUDO_COUNT = 0.1  # samples added to each bin, so that no recorded sample has the probability 0
RESAMPLES = 500


@dataclass(frozen=True)
class Feature:
    """A quantity of single samples: its column, the range in which it counts, the width of a bin, and its weight."""

    name: str
    label: str
    low: float
    high: float
    width: float
    weight: float


FEATURES = (
    Feature("v", "speed [m/s]", 0.0, 40.0, 1.0, 0.10),
    Feature("a", "acceleration [m/s²]", -6.0, 6.0, 0.2, 0.10),
    Feature("jerk", "jerk over 1 s [m/s³]", -6.0, 6.0, 0.2, 0.05),
    Feature("headway", "headway [m]", 0.0, 100.0, 4.0, 0.10),
    Feature("time_headway", "time headway [s]", 0.0, 10.0, 0.4, 0.15),
    Feature("gap", "gap [m]", 0.0, 100.0, 4.0, 0.10),
    Feature("relative_speed", "relative speed [m/s]", -10.0, 10.0, 0.5, 0.10),
    Feature("ttc", "time to collision [s]", 0.0, 60.0, 2.0, 0.10),
    Feature("lane", "lane use", 0.5, 8.5, 1.0, 0.05),
)
STATISTICS: dict[str, tuple[str, float]] = {
    "vehicle_sd": ("speed sd within a vehicle [m/s]", 0.05),
    "lane_sd": ("speed sd within a lane [m/s]", 0.0),
    "headway_sd": ("time headway sd [s]", 0.0),
    "short_headways": ("time headways < 1 s [%]", 0.0),
    "standing": ("standing, < 1 m/s [%]", 0.0),
    "slow_leftmost": ("leftmost lane < 3 m/s [%]", 0.05),
    "lane_changes": ("lane changes per vehicle-km", 0.05),
    **{f"autocorrelation_{lag}": (f"lane speed, correlation over {lag} s", 0.0) for lag in LAGS},
    "wave_speed": ("waves travel upstream at [km/h]", 0.0),
}
"""Quantities of whole windows, each with its label and its weight in the score."""


@dataclass(frozen=True)
class FeatureScore:
    """Shares of the recording's own likelihood: of all simulations, of each, and of another part of the recording.

    `uniform` is the share of a histogram with the same probability in all bins.
    """

    feature: Feature
    share: float
    by_seed: tuple[float, ...]
    ceiling: float
    uniform: float

    @property
    def of_ceiling(self) -> float:
        """The share in relation to that of another part of the recording; above 1 where the parts differ much."""
        return self.share / self.ceiling if self.ceiling > 0 else np.nan


@dataclass(frozen=True)
class StatisticScore:
    """A quantity of whole windows: simulated (in all, and per simulation), and recorded with its 95 % interval."""

    name: str
    simulated: float
    by_seed: tuple[float, ...]
    recorded: float
    low: float
    high: float

    @property
    def likeness(self) -> float:
        """The smaller of both values over the larger one; 1 if both are 0, NaN if one is unknown."""
        if np.isnan(self.simulated) or np.isnan(self.recorded):
            return np.nan
        large = max(self.simulated, self.recorded)
        return 1.0 if large <= 0 else max(0.0, min(self.simulated, self.recorded) / large)

    @property
    def inside(self) -> bool:
        """Whether the simulated value is in the recording's interval."""
        return bool(self.low <= self.simulated <= self.high)


@dataclass(frozen=True)
class TrafficScore:
    """The scores of simulated traffic; `total` and `ceiling` are weighted means. In the ceiling, statistics count 1."""

    features: tuple[FeatureScore, ...]
    statistics: tuple[StatisticScore, ...]
    total: float
    ceiling: float


def with_interactions(samples: pd.DataFrame) -> pd.DataFrame:
    """The samples (once per second, with `headway`) with `a`, `jerk`, `gap`, `relative_speed` and `ttc`.

    Gap, relative speed and time to collision are those to the vehicle ahead. The acceleration [m/s²] is that between
    the speeds one second before and after, because recordings are smoothed over 2 s and simulations are not; it
    replaces `a`. The jerk [m/s³] is its change over a second. A relative speed [m/s] above 0 closes the gap [m]; only
    then there is a time to collision [s].
    """
    ordered = samples.sort_values(["source", "time", "lane", "x"], kind="stable")
    ahead = ordered.shift(-1)
    followed = ordered["headway"].notna()
    gap = (ordered["headway"] - ahead["length"].where(ahead["length"] > 0)).where(followed)
    closing = (ordered["v"] - ahead["v"]).where(followed)
    added = ordered.assign(gap=gap, relative_speed=closing, ttc=(gap / closing).where(closing > 0))
    by_vehicle = added.sort_values(["source", "vehicle", "time"], kind="stable")
    by_vehicle["a"] = _rate(by_vehicle, "v", 1, -1)
    by_vehicle["jerk"] = _rate(by_vehicle, "a", 1, 0)
    return by_vehicle.loc[samples.index]


def _rate(by_vehicle: pd.DataFrame, column: str, before: int, after: int) -> pd.Series:
    """The change of a column per second, from `before` rows before to −`after` rows after; NaN across gaps in time."""
    tracks = by_vehicle.groupby(["source", "vehicle"], sort=False)[["time", column]]
    first, last = (tracks.shift(number) for number in (before, after))
    lasted = last["time"] - first["time"]
    return ((last[column] - first[column]) / lasted).where(lasted < before - after + 0.5)


def seed_interval(by_seed: tuple[float, ...]) -> tuple[float, float]:
    """The 95 % interval of the mean over seeds (Student's t); NaN for a single seed, and for an unknown value."""
    values = np.array(by_seed)
    if len(values) < 2 or not np.isfinite(values).all():
        return np.nan, np.nan
    half = float(t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))
    return float(values.mean()) - half, float(values.mean()) + half


def constant_traffic(recorded: pd.DataFrame, source: pd.DataFrame) -> pd.DataFrame:
    """The vehicles of a recording, each driving at the mean speed and mean distances of `source`, with `seed` 0.

    Lanes are used evenly, and nobody changes lanes or closes a gap. It is the baseline that knows the means and nothing
    else.
    """
    level = {name: source[name].mean() for name in ("v", "headway", "time_headway", "gap")}
    lanes = np.sort(recorded["lane"].dropna().unique())
    number = recorded.groupby(["window", "vehicle"], sort=False).ngroup()
    return recorded.assign(
        **level, a=0.0, jerk=0.0, relative_speed=0.0, ttc=np.nan, lane=lanes[number % len(lanes)], seed=0
    )


def traffic_score(simulated: pd.DataFrame, recorded: pd.DataFrame, other: pd.DataFrame | None) -> TrafficScore:
    """Score simulated samples, seen through the windows of the recording (`cosim.studies.observation_windows`).

    `other` are samples of another part of the recording, for the ceiling; without them, every second window of the
    recording is compared with the rest.
    """
    features = tuple(_feature_score(f, simulated, recorded, other) for f in FEATURES if _counted(recorded, f).size)
    statistics = tuple(_statistic_score(name, simulated, recorded) for name in STATISTICS)
    weighted = [(s.feature.weight, s.share, s.ceiling) for s in features]
    weighted += [
        (STATISTICS[s.name][1], s.likeness, 1.0)
        for s in statistics
        if STATISTICS[s.name][1] and not np.isnan(s.likeness)
    ]
    weights, shares, ceilings = (np.array(column) for column in zip(*weighted, strict=True))
    return TrafficScore(
        features, statistics, float(np.average(shares, weights=weights)), float(np.average(ceilings, weights=weights))
    )


def _feature_score(
    feature: Feature, simulated: pd.DataFrame, recorded: pd.DataFrame, other: pd.DataFrame | None
) -> FeatureScore:
    tested = _counted(recorded, feature)
    seeds = [_counted(part, feature) for _, part in simulated.groupby("seed")]
    if other is None:
        even, odd = (_counted(recorded[recorded["window"] % 2 == k], feature) for k in (0, 1))
        ceiling = float(np.nanmean([_share(even, odd, feature), _share(odd, even, feature)])) if odd.size else np.nan
    else:
        ceiling = _share(_counted(other, feature), tested, feature)
    return FeatureScore(
        feature,
        _share(_counted(simulated, feature), tested, feature),
        tuple(_share(values, tested, feature) for values in seeds),
        ceiling,
        _share(np.empty(0), tested, feature),
    )


def _counted(samples: pd.DataFrame, feature: Feature) -> Float[np.ndarray, " samples"]:
    values = samples[feature.name].to_numpy(float) if feature.name in samples else np.empty(0)
    return values[(values >= feature.low) & (values < feature.high)]


def _share(model: np.ndarray, tested: np.ndarray, feature: Feature) -> float:
    """exp of the mean log-likelihood of the tested samples under the model's histogram less that under their own.

    A model without samples gives all bins the same probability.
    """
    if not len(tested):
        return np.nan
    counts = _histogram(tested, feature)
    p, q = (_probabilities(c) for c in (counts, _histogram(model, feature)))
    return float(np.exp(np.average(np.log(q) - np.log(p), weights=counts)))


def _histogram(values: np.ndarray, feature: Feature) -> np.ndarray:
    bins = round((feature.high - feature.low) / feature.width)
    return np.histogram(values, bins, (feature.low, feature.high))[0].astype(float)


def _probabilities(counts: np.ndarray) -> np.ndarray:
    smooth = counts + PSEUDO_COUNT
    return smooth / smooth.sum()


def _statistic_score(name: str, simulated: pd.DataFrame, recorded: pd.DataFrame) -> StatisticScore:
    """Windows are resampled for the interval of the recording: samples of one window resemble each other."""
    per_window = sums_of(name, recorded)
    rng = np.random.default_rng(0)
    draws = rng.multinomial(len(per_window), np.full(len(per_window), 1 / len(per_window)), size=RESAMPLES)
    values = np.array([_value(name, draw @ per_window) for draw in draws])
    low, high = np.nanquantile(values, (0.025, 0.975)) if np.isfinite(values).any() else (np.nan, np.nan)
    return StatisticScore(
        name,
        _value(name, sums_of(name, simulated).sum(0)),
        tuple(_value(name, sums_of(name, part).sum(0)) for _, part in simulated.groupby("seed")),
        _value(name, per_window.sum(0)),
        float(low),
        float(high),
    )


def sums_of(name: str, samples: pd.DataFrame) -> Float[np.ndarray, "windows sums"]:
    """What is summed over windows for a statistic, in each of the windows.

    That is numerator and denominator, whose ratio it is; for the speed of waves there are three sums per lag.
    """
    numbers, window = np.unique(samples["window"].to_numpy(), return_inverse=True)
    return SUMS[name](samples, window, len(numbers)).astype(float)


def _value(name: str, sums: np.ndarray) -> float:
    if name == "wave_speed":
        return wave_speed(sums)
    if sums[1] <= 0:
        return np.nan
    ratio = sums[0] / sums[1]
    return float(np.sqrt(ratio) if name.endswith("_sd") else ratio)
