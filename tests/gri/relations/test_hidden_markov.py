"""The chain against a sum over all paths."""

from itertools import product

import pytest
import torch

from gri.relations.hidden_markov import IMPOSSIBLE, log_evidence, smooth

T, K, STAY = 5, 3, 0.8


@pytest.fixture
def chain():
    generator = torch.Generator().manual_seed(0)
    likelihood = torch.randn(T, K, generator=generator, dtype=torch.float64)
    share = torch.rand(T, K, generator=generator, dtype=torch.float64)
    share[2, 1] = 0  # not admissible in this step
    share /= share.sum(-1, keepdim=True)
    return likelihood, share


def by_enumeration(likelihood, share):
    """P(all observations) and P(state, all observations) of each step, summed over the K^T paths."""
    total, joint = 0.0, torch.zeros(T, K, dtype=torch.float64)
    for path in product(range(K), repeat=T):
        p = share[0, path[0]] * likelihood[0, path[0]].exp()
        for t in range(1, T):
            stays = STAY if share[t, path[t - 1]] > 0 else 0.0
            p = p * (stays * (path[t] == path[t - 1]) + (1 - stays) * share[t, path[t]]) * likelihood[t, path[t]].exp()
        total += p
        for t, state in enumerate(path):
            joint[t, state] += p
    return total, joint


def test_passes_agree_with_the_sum_over_all_paths(chain):
    likelihood, share = chain
    prior = torch.where(share > 0, share.log(), IMPOSSIBLE)
    total, joint = by_enumeration(likelihood, share)
    found = smooth(likelihood, prior, STAY)
    assert found.evidence.item() == pytest.approx(total.log().item(), abs=1e-9)
    assert log_evidence(likelihood, prior, STAY).item() == pytest.approx(total.log().item(), abs=1e-9)
    assert torch.allclose(found.marginals, joint / total, atol=1e-9)


def test_what_is_not_admissible_has_no_probability(chain):
    likelihood, share = chain
    prior = torch.where(share > 0, share.log(), IMPOSSIBLE)
    likelihood[2, 1] = 50.0
    assert smooth(likelihood, prior, STAY).marginals[2, 1] < 1e-12


def test_batches_are_solved_apart(chain):
    likelihood, share = chain
    prior = torch.where(share > 0, share.log(), IMPOSSIBLE)
    other = torch.stack([likelihood, -likelihood])
    both = smooth(other, prior.expand_as(other), STAY).marginals
    assert torch.allclose(both[0], smooth(likelihood, prior, STAY).marginals)
    assert torch.allclose(both[1], smooth(-likelihood, prior, STAY).marginals)
