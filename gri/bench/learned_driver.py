"""A driver learned from recorded pairs, and the question whether the candidate explains it better than a stranger.

The driver's acceleration is linear in its own past and in what the leader does. The null is a leader that is not in the
scene: the same driver, averaged over leaders of other windows with nearly the same mean speed, put where the candidate
began. A term for the gap tells how likely such a gap is at such a speed.
"""

from dataclasses import dataclass
from math import log

import torch
from jaxtyping import Float
from torch import Tensor

from gri.bench.answers import Score, observed
from gri.bench.car_following_scenes import DT, LENGTH, KnownScenes
from gri.core.edges import pairs
from gri.data.ngsim.following_windows import FollowingWindows

OTHERS = 24  # leaders that the null is averaged over
DELAYS = (0, 2, 4, 6)  # steps, of the speed difference and of the leader's acceleration
RIDGE = 1e-2
GAPS = (4.0, 400.0)  # [m], of a candidate that is not followed: log-uniform


@dataclass(frozen=True)
class _Driver:
    weights: Float[Tensor, " P"]
    noise: float
    gap: Float[Tensor, " 3"]
    """Intercept, slope over log speed, and standard deviation of the log gap."""

    def log_likelihood(
        self, v: Float[Tensor, "S T"], gap: Float[Tensor, "S T"], leader: Float[Tensor, "S T"]
    ) -> Tensor:
        target, design = _design(v, gap, leader)
        return -0.5 * ((target - design @ self.weights) / self.noise).square().sum(-1)

    def log_gap_odds(self, v: Float[Tensor, "S T"], gap: Float[Tensor, "S T"]) -> Float[Tensor, " S"]:
        speed, room = v.mean(-1).clamp(min=1).log(), gap.mean(-1).clamp(min=1).log()
        intercept, slope, spread = self.gap.tolist()
        density = -0.5 * ((room - intercept - slope * speed) / spread) ** 2 - log(spread * (2 * torch.pi) ** 0.5)
        return density + log(log(GAPS[1] / GAPS[0]))


def _design(
    v: Float[Tensor, "S T"], gap: Float[Tensor, "S T"], leader: Float[Tensor, "S T"]
) -> tuple[Float[Tensor, "S U"], Float[Tensor, "S U P"]]:
    a, b = ((speed[:, 1:] - speed[:, :-1]) / DT for speed in (v, leader))
    late, last = max(DELAYS) + 1, a.shape[-1]

    def at(series: Tensor, delay: int) -> Tensor:
        return series[:, late - delay : last - delay]

    room = gap.clamp(min=1)
    columns = [torch.ones_like(at(a, 0)), at(a, 1), at(a, 2), at(v, 0) / 10, (at(v, 0) / 10) ** 2]
    columns += [at(room.log(), 0), at(v / room, 0).clamp(max=3)]
    columns += [at(leader - v, delay) for delay in DELAYS]
    columns += [at(b, delay + 1) for delay in DELAYS]
    return at(a, 0), torch.stack(columns, -1)


def learn_driver(windows: FollowingWindows, seed: int) -> Score:
    """A score of ordered pairs: log likelihood with the sender as leader, minus that with leaders of other windows."""
    del seed
    x, v = windows.state[..., 0], windows.state[..., 1]
    gap = x[:, 1] - x[:, 0] - LENGTH
    target, design = _design(v[:, 0], gap, v[:, 1])
    design, target = design.flatten(0, 1), target.flatten()
    eye = RIDGE * torch.eye(design.shape[-1], dtype=design.dtype)
    weights = torch.linalg.solve(design.mT @ design + eye, design.mT @ target)
    noise = float((target - design @ weights).std())
    speed, room = v[:, 0].mean(-1).clamp(min=1).log(), gap.mean(-1).clamp(min=1).log()
    line = torch.stack([torch.ones_like(speed), speed], -1)
    fitted = torch.linalg.lstsq(line, room[:, None]).solution[:, 0]
    driver = _Driver(weights, noise, torch.cat([fitted, (room - line @ fitted).std()[None]]))
    pool_x, pool_v = x[:, 1] - x[:, 1, :1], v[:, 1]
    pool_mean = pool_v.mean(-1)

    def score(scenes: KnownScenes) -> Float[Tensor, "S E"]:
        seen = observed(scenes)
        found = []
        for i, j in pairs(seen.shape[1]):
            own, other = seen[:, j], seen[:, i]
            gap = other[..., 0] - own[..., 0] - LENGTH
            near = (pool_mean[None] - other[..., 1].mean(-1, keepdim=True)).abs().argsort(1)[:, :OTHERS]
            null = []
            for k in range(near.shape[1]):
                start = gap[:, :1] - (own[..., 0] - own[:, :1, 0])
                null.append(driver.log_likelihood(own[..., 1], start + pool_x[near[:, k]], pool_v[near[:, k]]))
            odds = driver.log_likelihood(own[..., 1], gap, other[..., 1])
            odds = odds - torch.logsumexp(torch.stack(null), 0) + log(len(null))
            found.append(odds + driver.log_gap_odds(own[..., 1], gap))
        return torch.stack(found, 1)

    return score
