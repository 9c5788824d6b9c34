"""How far simulated traffic is from recorded traffic: distances between distributions, with their uncertainty.

Wasserstein-1 distance: the mean distance by which probability has to be moved, in the unit of the quantity.
Jensen-Shannon distance: the square root of the divergence to base 2, between 0 (equal) and 1 (disjoint); it depends on
the bins.

Samples of one vehicle are correlated, so intervals come from resampling vehicles, of both sources. Both distances are
above 0 even between two samples of the same traffic. `floor` is therefore the median distance between two random halves
of the recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.spatial.distance import jensenshannon
from scipy.stats import wasserstein_distance

from cosim.measures.statistics import Estimate

RESAMPLES = 300
FINE_PER_COARSE_BIN = 4  # the Jensen-Shannon distance uses coarse bins


@dataclass(frozen=True)
class Quantity:
    """A quantity to compare: a column of a table of samples, the range in which it counts, and its fine bin width."""

    name: str
    label: str
    unit: str
    low: float
    high: float
    width: float

    @property
    def centres(self) -> Float[np.ndarray, " bins"]:
        return self.low + self.width * (np.arange(round((self.high - self.low) / self.width)) + 0.5)


QUANTITIES = (
    Quantity("v", "speed", "m/s", 0.0, 40.0, 0.25),
    Quantity("a", "acceleration", "m/s²", -6.0, 6.0, 0.05),
    Quantity("headway", "headway", "m", 0.0, 100.0, 1.0),
    Quantity("time_headway", "time headway", "s", 0.0, 10.0, 0.1),
    Quantity("time_gap", "time gap", "s", 0.0, 10.0, 0.1),
    Quantity("gap", "gap", "m", 0.0, 100.0, 0.5),
    Quantity("relative_speed", "relative speed", "m/s", -10.0, 10.0, 0.1),
    Quantity("ttc", "time to collision", "s", 0.0, 60.0, 1.0),
)


@dataclass(frozen=True)
class Distance:
    """The distances between simulated and recorded samples of one quantity, with vehicles and means (in this order).

    `part` names the samples, such as a lane; `floor` has the floors of both distances.
    """

    part: str
    quantity: Quantity
    vehicles: tuple[int, int]
    means: tuple[float, float]
    wasserstein: Estimate
    jensen_shannon: Estimate
    floor: tuple[float, float]


def distances(part: str, simulated: pd.DataFrame, recorded: pd.DataFrame, seed: int = 0) -> list[Distance]:
    """Distances of all quantities that both tables of samples have. Values outside a quantity's range do not count."""
    found = []
    for quantity in QUANTITIES:
        if quantity.name in simulated and quantity.name in recorded:
            ours, theirs = _in_range(simulated, quantity), _in_range(recorded, quantity)
            if len(ours) and len(theirs):
                found.append(_distance(part, quantity, ours, theirs, np.random.default_rng(seed)))
    return found


def _in_range(samples: pd.DataFrame, quantity: Quantity) -> pd.DataFrame:
    return samples[samples[quantity.name].between(quantity.low, quantity.high, inclusive="left")]


def _distance(
    part: str, quantity: Quantity, simulated: pd.DataFrame, recorded: pd.DataFrame, rng: np.random.Generator
) -> Distance:
    ours, theirs = _histograms(simulated, quantity), _histograms(recorded, quantity)
    whole = partial(np.sum, axis=0, keepdims=True)
    point = _distances_of(whole(ours), whole(theirs), quantity)[:, 0]
    resampled = _distances_of(_resampled(ours, rng), _resampled(theirs, rng), quantity)
    low, high = np.quantile(resampled, (0.025, 0.975), axis=1)
    floor = np.median(_distances_of(*_halves(theirs, rng), quantity), axis=1) if len(theirs) > 1 else np.full(2, np.nan)
    vehicles = len(ours)  # they are resampled, so each is a cluster
    estimates = [Estimate(float(point[k]), float(low[k]), float(high[k]), vehicles, vehicles) for k in range(2)]
    return Distance(
        part,
        quantity,
        (len(ours), len(theirs)),
        (float(simulated[quantity.name].mean()), float(recorded[quantity.name].mean())),
        estimates[0],
        estimates[1],
        (float(floor[0]), float(floor[1])),
    )


def _histograms(samples: pd.DataFrame, quantity: Quantity) -> Float[np.ndarray, "vehicles bins"]:
    """Counts in the fine bins, one row per vehicle."""
    vehicle = pd.MultiIndex.from_frame(samples[["source", "vehicle"]]).factorize()[0]
    bins = len(quantity.centres)
    which = ((samples[quantity.name].to_numpy() - quantity.low) / quantity.width).astype(int).clip(0, bins - 1)
    counts = np.zeros((int(vehicle.max()) + 1, bins))
    np.add.at(counts, (vehicle, which), 1.0)
    return counts


def _resampled(counts: Float[np.ndarray, "vehicles bins"], rng: np.random.Generator) -> Float[np.ndarray, "draws bins"]:
    """Histograms of the same number of vehicles, drawn with replacement."""
    n = len(counts)
    return rng.multinomial(n, np.full(n, 1 / n), size=RESAMPLES).astype(float) @ counts


def _halves(
    counts: Float[np.ndarray, "vehicles bins"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "draws bins"], Float[np.ndarray, "draws bins"]]:
    """Histograms of two random halves of the vehicles, for RESAMPLES splits."""
    first = rng.permuted(np.tile(np.arange(len(counts)) < len(counts) // 2, (RESAMPLES, 1)), axis=1).astype(float)
    return first @ counts, (1 - first) @ counts


def _distances_of(
    ours: Float[np.ndarray, "draws bins"], theirs: Float[np.ndarray, "draws bins"], quantity: Quantity
) -> Float[np.ndarray, "2 draws"]:
    """Wasserstein and Jensen-Shannon distance between each pair of histograms."""
    x = quantity.centres
    moved = [wasserstein_distance(x, x, p, q) for p, q in zip(ours, theirs, strict=True)]
    coarse = (counts.reshape(len(counts), -1, FINE_PER_COARSE_BIN).sum(-1) for counts in (ours, theirs))
    apart = [jensenshannon(p, q, 2) for p, q in zip(*coarse, strict=True)]
    return np.array([moved, apart])


def distances_frame(found: Sequence[Distance]) -> pd.DataFrame:
    """One row per part and quantity, for a file; means and Wasserstein distances in `unit`."""
    return pd.DataFrame(
        [
            {
                "part": d.part,
                "quantity": d.quantity.name,
                "unit": d.quantity.unit,
                "vehicles": d.vehicles[0],
                "recorded_vehicles": d.vehicles[1],
                "mean": d.means[0],
                "recorded_mean": d.means[1],
                **{
                    f"{name}{end}": getattr(estimate, key)
                    for name, estimate in (("wasserstein", d.wasserstein), ("jensen_shannon", d.jensen_shannon))
                    for end, key in (("", "value"), ("_low", "low"), ("_high", "high"))
                },
                "wasserstein_floor": d.floor[0],
                "jensen_shannon_floor": d.floor[1],
            }
            for d in found
        ]
    )
