"""The closed form: invariances, structure, and that it does not recite where vehicles stand."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from gri.bench.car_following_scenes import SceneFamily, draw_scenes
from gri.bench.driver_models import LINEAR
from gri.bench.scores import balanced_accuracy, false_follow
from gri.core.edges import pairs
from gri.relations.closed_form_posterior import Explanations, Grid, Weights, _gaussian, explain, follow_probabilities

NEAR = SceneFamily("near", headway=(10.0, 50.0), action_noise=0.05, perception_noise=0.01)
AHEAD = [edge for edge, (i, j) in enumerate(pairs(3)) if i > j]


def inferred(state: torch.Tensor, **options) -> torch.Tensor:
    found = explain(state[:, :, :31, 0], state[:, :, :31, 1], 0.2, **options)
    return follow_probabilities(found.posterior(Weights()))


@pytest.fixture(scope="module")
def known():
    return draw_scenes(NEAR, LINEAR, 120, 1)


def test_the_evidence_is_the_gaussian_integral():
    """Against scipy's density of N(X m, σ²I + X S X')."""
    rng = np.random.default_rng(0)
    y, design = rng.normal(size=8), rng.normal(size=(8, 3))
    mean, sd = (0.2, -0.1, 0.4), (0.5, 0.3, 0.2)
    found = _gaussian(
        torch.tensor(y), torch.tensor(design), tuple(zip(mean, sd, strict=True)), Grid(noise=(0.3,), correlation=(0.0,))
    )
    covariance = 0.09 * np.eye(8) + design @ np.diag(np.square(sd)) @ design.T
    assert found.item() == pytest.approx(multivariate_normal(design @ mean, covariance).logpdf(y), abs=1e-9)


def test_correlated_noise_is_whitened():
    """With φ the density is that of the innovations; the transformation has determinant one."""
    rng = np.random.default_rng(1)
    y, design = rng.normal(size=6), rng.normal(size=(6, 2))
    back = np.eye(6) - 0.5 * np.eye(6, k=-1)
    plain = _gaussian(
        torch.tensor(back @ y),
        torch.tensor(back @ design),
        ((0.0, 1.0), (0.0, 1.0)),
        Grid(noise=(0.1,), correlation=(0.0,)),
    )
    white = _gaussian(
        torch.tensor(y), torch.tensor(design), ((0.0, 1.0), (0.0, 1.0)), Grid(noise=(0.1,), correlation=(0.5,))
    )
    assert white.item() == pytest.approx(plain.item(), abs=1e-9)


def test_only_those_ahead_can_be_followed_and_one_at_a_time(known):
    found = explain(known.state[:20, :, :31, 0], known.state[:20, :, :31, 1], 0.2)
    shares = found.posterior(Weights())
    for j in range(3):
        assert shares[:, j, : j + 1].max() == 0
    assert (shares.sum(-1) <= 1 + 1e-12).all()


def test_where_the_origin_lies_does_not_matter(known):
    moved = known.state[:20].clone()
    moved[..., 0] += 1234.5
    assert torch.allclose(inferred(known.state[:20]), inferred(moved), atol=1e-6)


def test_relations_are_found_and_strangers_are_left_alone(known):
    """On drivers of its own form with little noise; a vehicle behind a stranger must not follow."""
    p, truth = inferred(known.state)[:, AHEAD].numpy(), known.graph()[:, AHEAD].numpy() > 0
    assert balanced_accuracy(p, truth) > 0.75
    nobody = draw_scenes(replace(NEAR, follows=0.0, unseen=0.0), LINEAR, 80, 2)
    p, truth = inferred(nobody.state)[:, AHEAD].numpy(), nobody.graph()[:, AHEAD].numpy() > 0
    assert false_follow(p, truth) < 0.15


def test_weights_are_learned_without_labels():
    """From evidences of a world in which nobody follows, the weight of following goes down, and the other way round."""
    rng = torch.Generator().manual_seed(0)
    noise = torch.randn(500, 2, generator=rng, dtype=torch.float64)
    own = torch.stack([noise[:, 0], torch.zeros(500, dtype=torch.float64)], 1)
    follow = torch.full((500, 2, 2), -torch.inf, dtype=torch.float64)
    follow[:, 0, 1] = noise[:, 1] - 4
    assert Explanations(own, own - 9, follow).weights().follow < 0.1
    follow[:, 0, 1] = noise[:, 1] + 4
    assert Explanations(own, own - 9, follow).weights().follow > 0.8


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_what_is_not_finite_is_an_error_and_never_none(known, bad):
    state = known.state[:4].clone()
    state[1, 0, 3, 1] = bad
    with pytest.raises(ValueError, match="not finite"):
        inferred(state)


def test_too_short_a_history_is_an_error(known):
    with pytest.raises(ValueError, match="got 6 steps, wanted at least 10"):
        explain(known.state[:4, :, :6, 0], known.state[:4, :, :6, 1], 0.2)
