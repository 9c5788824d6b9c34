"""`gri.networks.reaction_evidence`, computed faster for many pairs.

The definition decomposes one matrix per pair, delay and form. Here the columns that all forms share (the driver's own
motion) are eliminated once per pair and noise level; what is left for each delay and form is a matrix of 2 x 2, which
is solved by hand. tests/gri/networks/test_fast_pair_encoder.py compares both.
"""

from math import log, pi

import torch
from jaxtyping import Float
from torch import Tensor

from gri.networks.reaction_evidence import DELAYS, LINEAR, NOISE, OWN, RATIO, linear_columns, ratio_columns

SHARED = len(OWN)


def reaction_evidence(
    gap: Float[Tensor, "P T"], own: Float[Tensor, "P T"], other: Float[Tensor, "P T"], dt: float
) -> Float[Tensor, "P F"]:
    """The same values as `gri.networks.reaction_evidence.reaction_evidence`, up to rounding."""
    gram, steps = _products(gap.double(), own.double(), other.double(), dt)
    precision = torch.tensor([sigma**-2 for sigma in NOISE], dtype=gram.dtype)[:, None]
    rows, pivots = _eliminated(gram[:SHARED, :, None] * precision)
    weights = [row / pivot for row, pivot in zip(rows, pivots, strict=True)]

    def left(a: Tensor, b: Tensor) -> Float[Tensor, "F N P"]:
        """Products of columns over σ², without what the shared columns explain of them."""
        explained = [weight[a] * row[b] for weight, row in zip(weights, rows, strict=True)]
        return gram[a, b][:, None] * precision - sum(explained[1:], explained[0])

    first = torch.arange(SHARED, len(gram) - 1, 2)
    second, residual = first + 1, torch.full_like(first, len(gram) - 1)
    square, s11, s12, s22 = (
        left(residual[:1], residual[:1]),
        left(first, first),
        left(first, second),
        left(second, second),
    )
    log_det = torch.stack(pivots).log().sum(0) + steps * (log(2 * pi) - precision.log())
    base = (-0.5 * (square + log_det)).logsumexp(1)
    m1, m2 = gram.new_tensor(_prior_means())[..., None, None]
    c1, c2 = left(first, residual), left(second, residual)
    rest = square - 2 * (m1 * c1 + m2 * c2) + m1 * (m1 * s11 + 2 * m2 * s12) + m2 * m2 * s22
    c1, c2 = c1 - s11 * m1 - s12 * m2, c2 - s12 * m1 - s22 * m2
    determinant = (1 + s11) * (1 + s22) - s12**2
    gain = ((1 + s22) * c1**2 - 2 * s12 * c1 * c2 + (1 + s11) * c2**2) / determinant
    forms = (-0.5 * (rest - gain + log_det + determinant.log())).logsumexp(1)
    return torch.cat([(base - log(len(NOISE))) / steps, forms - base]).T


def _products(
    gap: Float[Tensor, "P T"], own: Float[Tensor, "P T"], other: Float[Tensor, "P T"], dt: float
) -> tuple[Float[Tensor, "C C P"], int]:
    """Products of all columns in units of their priors, and the number of accelerations.

    The columns are those of the own motion, two for every delay and form, and what the prior's mean leaves of the
    accelerations.
    """
    first = round(max(DELAYS) / dt)
    a = (own[:, 1:] - own[:, :-1]) / dt
    y, v = a[:, first:], own[:, first:-1] - own.mean(-1, keepdim=True)
    shared = [a[:, first - 1 : -1], torch.ones_like(y), v, v**2]
    columns = [column * sd for column, (_, sd) in zip(shared, OWN, strict=True)]
    for delay in DELAYS:
        late = slice(first - round(delay / dt), a.shape[1] - round(delay / dt))
        for form, prior in ((linear_columns, LINEAR), (ratio_columns, RATIO)):
            reaction = form(gap[:, late], own[:, late], other[:, late])
            columns += [column * sd for column, (_, sd) in zip(reaction, prior, strict=True)]
    residual = y - sum(mean * column for column, (mean, _) in zip(shared, OWN, strict=True))
    matrix = torch.stack([*columns, residual], 1)
    return torch.bmm(matrix, matrix.mT).permute(1, 2, 0).contiguous(), y.shape[1]


def _prior_means() -> list[list[float]]:
    """Prior means of both coefficients of every delay and form, in units of their standard deviations."""
    forms = [form for _ in DELAYS for form in (LINEAR, RATIO)]
    return [[form[k][0] / form[k][1] for form in forms] for k in (0, 1)]


def _eliminated(rows: Float[Tensor, "S C N P"]) -> tuple[list[Tensor], list[Tensor]]:
    """Rows of the shared columns with unit prior after Gaussian elimination, and their pivots."""
    done, pivots = [], []
    for k in range(len(rows)):
        row = rows[k].clone()
        row[k] += 1
        for earlier, pivot in zip(done, pivots, strict=True):
            row -= (earlier[k] / pivot) * earlier
        done.append(row)
        pivots.append(row[k])
    return done, pivots
