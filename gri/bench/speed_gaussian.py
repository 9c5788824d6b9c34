"""Joint Gaussians of the speeds of two vehicles: do they move as recorded pairs, or as strangers of equal speed?"""

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.fft import dct
from torch import Tensor

from gri.bench.answers import Score, observed
from gri.bench.car_following_scenes import KnownScenes
from gri.core.edges import pairs
from gri.data.ngsim.following_windows import FollowingWindows

WAVES = 8  # cosines per vehicle and 6 s; slower changes than 1.5 s
BINS = 3  # of the mean speed
SHRINKAGE = 0.1  # of covariances towards their diagonal


def fit_gaussians(windows: FollowingWindows) -> Score:
    """A score of ordered pairs: log density among recorded pairs minus that among strangers, in bins of mean speed."""
    waves = WAVES * (windows.state.shape[2] - 1) // 30
    v = windows.state[..., 1].numpy()
    recorded = windows.kind == "recorded"
    mean = v.mean((1, 2))
    edges = np.quantile(mean[recorded], np.linspace(0, 1, BINS + 1)[1:-1])
    features, place = _features(v[:, 0], v[:, 1], waves), np.digitize(mean, edges)
    fitted = [
        [_moments(features[(place == which) & chosen]) for which in range(BINS)] for chosen in (recorded, ~recorded)
    ]

    def score(scenes: KnownScenes) -> Float[Tensor, "S E"]:
        speeds = observed(scenes)[..., 1].numpy()
        found = []
        for i, j in pairs(speeds.shape[1]):
            seen = _features(speeds[:, j], speeds[:, i], waves)
            which = np.digitize(speeds[:, [i, j]].mean((1, 2)), edges)
            found.append(_log_density(seen, which, fitted[0]) - _log_density(seen, which, fitted[1]))
        return torch.from_numpy(np.stack(found, 1))

    return score


def _features(
    follower: Float[np.ndarray, "S T"], leader: Float[np.ndarray, "S T"], waves: int
) -> Float[np.ndarray, "S F"]:
    both = np.stack([follower, leader], 1)
    both = both - both.mean((1, 2), keepdims=True)
    return np.asarray(dct(both, norm="ortho", axis=-1))[..., :waves].reshape(len(both), -1)


def _moments(seen: Float[np.ndarray, "S F"]) -> tuple[np.ndarray, np.ndarray]:
    covariance = np.cov(seen.T)
    spread = np.diag(np.diag(covariance)) + 1e-4 * np.eye(len(covariance))
    return seen.mean(0), (1 - SHRINKAGE) * covariance + SHRINKAGE * spread


def _log_density(
    seen: Float[np.ndarray, "S F"], which: Int[np.ndarray, " S"], fitted: list[tuple[np.ndarray, np.ndarray]]
) -> Float[np.ndarray, " S"]:
    values = []
    for mean, covariance in fitted:
        whitened = np.linalg.solve(np.linalg.cholesky(covariance), (seen - mean).T)
        values.append(-0.5 * (whitened**2).sum(0) - 0.5 * np.linalg.slogdet(covariance)[1])
    return np.stack(values)[which, np.arange(len(seen))]
