"""A test that may be looked at after every cluster: it decides which of two policies is better, or goes on.

The usual p-values hold for a number of starts that was fixed before. Whoever goes on until p < 5 % decides wrongly far
more often than in 5 % of the cases. The test here is *anytime-valid*: however often it is looked at, and whenever it
stops, it decides wrongly with at most the stated probability (Ville 1939; Ramdas, Grünwald, Vovk and Shafer 2023).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

_STAKES = np.arange(0.05, 1.0, 0.05)  # shares of the capital that are bet


@dataclass(frozen=True)
class Decision:
    """State of a sequential comparison of two policies a and b after some clusters.

    `better` is 1 if a has the larger mean, −1 if b has, 0 as long as that is undecided. `e_value` is the evidence
    against equal means: under equality it exceeds 1/error at any time with a probability of at most `error`.
    """

    better: int
    e_value: float
    clusters: int
    mean_difference: float


def capital(differences: Float[np.ndarray, " G"]) -> Float[np.ndarray, " G"]:
    """The capital after each cluster of a gambler who bets that the mean of `differences` is larger than 0.

    Before each cluster the gambler bets the share λ of the capital; the difference x of the cluster, in [−1, 1],
    multiplies it by 1 + λx. If the mean given the past is at most 0, the capital is a non-negative supermartingale that
    begins with 1. The result is the mean over several λ, which is one as well (Waudby-Smith and Ramdas 2024, Sec. 4).
    """
    assert np.isfinite(differences).all(), "differences must be finite"
    assert (np.abs(differences) <= 1).all(), "a difference of two means of values in [0, 1] is in [−1, 1]"
    return np.exp(np.cumsum(np.log1p(np.multiply.outer(_STAKES, differences)), axis=1)).mean(0)


def decide(differences: Float[np.ndarray, " G"], error: float) -> Decision:
    """Compare two policies by the differences of their means in each cluster, a − b, in the order of the clusters.

    The null hypothesis is that the mean difference of the next cluster is 0, whatever happened before. Starts inside a
    cluster may depend on each other in any way. The decision is the first one in this order; later clusters do not
    change it. `error` is the probability of any decision if the means are equal.
    """
    up, down = capital(differences), capital(-differences)
    evidence = (up + down) / 2
    crossed = np.flatnonzero(evidence >= 1 / error)
    if not len(crossed):
        at = len(differences) - 1
        best = float(evidence[at]) if len(evidence) else 1.0
        return Decision(0, best, len(differences), float(differences.mean()) if len(differences) else np.nan)
    at = int(crossed[0])
    so_far = float(differences[: at + 1].mean())
    return Decision(1 if up[at] > down[at] else -1, float(evidence[at]), at + 1, so_far)
