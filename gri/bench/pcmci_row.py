"""PCMCI (Runge et al. 2019) by tigramite, which is not among the requirements: `pip install gri-cosim[bench]`.

Time-lagged conditional independence of accelerations, by partial correlation. Links from vehicles behind are ruled out
beforehand, as in all rows with a threshold.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from gri.bench.answers import observed
from gri.bench.car_following_scenes import KnownScenes, accelerations
from gri.core.edges import pairs

LAGS = 4  # steps
PC_ALPHA = 0.2  # tigramite's default


def pcmci(known: KnownScenes) -> Float[Tensor, "S E"]:
    """−log of the least p-value over lags of up to 0.8 s; 0 for pairs from behind."""
    from tigramite.data_processing import DataFrame
    from tigramite.independence_tests.parcorr import ParCorr
    from tigramite.pcmci import PCMCI

    a = accelerations(observed(known)[..., 1]).mT.numpy()
    n = a.shape[-1]
    links = {j: {(i, -lag): "-?>" for i in range(j, n) for lag in range(1, LAGS + 1)} for j in range(n)}
    found = torch.zeros(len(a), len(pairs(n)), dtype=torch.float64)
    for scene, series in enumerate(a):
        method = PCMCI(DataFrame(series), ParCorr(), verbosity=0)
        p = method.run_pcmci(link_assumptions=links, tau_min=1, tau_max=LAGS, pc_alpha=PC_ALPHA)["p_matrix"]
        for edge, (i, j) in enumerate(pairs(n)):
            if i > j:
                found[scene, edge] = -float(torch.tensor(p[i, j, 1:].min()).clamp(min=1e-12).log())
    return found
