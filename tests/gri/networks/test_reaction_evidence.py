"""The evidence in closed form: against a multivariate normal, and that it tells a follower from a stranger."""

import numpy as np
import torch
from scipy.stats import multivariate_normal

from gri.networks import reaction_evidence
from gri.networks.reaction_evidence import EVIDENCES, NOISE, log_evidence


def test_against_the_multivariate_normal(generator: torch.Generator):
    y = torch.randn(3, 8, generator=generator, dtype=torch.float64)
    design = torch.randn(3, 8, 2, generator=generator, dtype=torch.float64)
    prior = ((0.3, 0.5), (-0.1, 0.2))
    found = log_evidence(y, design, prior)
    for p in range(3):
        x = design[p].numpy()
        mean, spread = x @ np.array([0.3, -0.1]), x @ np.diag([0.25, 0.04]) @ x.T
        levels = [multivariate_normal(mean, spread + s**2 * np.eye(8)).logpdf(y[p].numpy()) for s in NOISE]
        np.testing.assert_allclose(found[p], np.logaddexp.reduce(levels) - np.log(len(NOISE)), rtol=1e-9)


def test_a_follower_has_evidence_and_a_stranger_has_not(generator: torch.Generator):
    """The follower is linear with constants far from the priors' means; the stranger moves like its leader."""
    steps, dt = 60, 0.1
    leaders = 12 + torch.randn(40, 2, steps, generator=generator, dtype=torch.float64).cumsum(-1) * 0.3
    x_leader = leaders.cumsum(-1) * dt
    v, x, path = torch.full((40,), 12.0).double(), torch.full((40,), -30.0).double(), []
    for t in range(steps):
        path.append(torch.stack([x, v], -1))
        a = 0.15 * (x_leader[:, 0, t] - x - 5 - 1.8 * v) + 0.8 * (leaders[:, 0, t] - v)
        v = v + a * dt
        x = x + v * dt
    x, v = torch.stack(path, 1).unbind(-1)
    half = slice(0, steps, 2)
    found = []
    for leader in (0, 1):
        gap = (x_leader[:, leader] - x - 5).clamp(min=0.5)
        found.append(reaction_evidence.reaction_evidence(gap[:, half], v[:, half], leaders[:, leader, half], 0.2))
    follower, stranger = (f[:, 1:].amax(-1) for f in found)
    assert found[0].shape == (40, EVIDENCES)
    assert float(follower.median()) > 5
    assert float((follower > stranger).double().mean()) > 0.9
