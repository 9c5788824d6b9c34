"""Which episodes of a batch to look at first."""

import numpy as np
import pandas as pd

from cosim.batch.group_statistics import driven


def worst(groups: pd.DataFrame, count: int) -> pd.DataFrame:
    """The groups that went worst: contacts first, then the shortest time to collision, then the smallest gap.

    At most two of one policy and perturbation, so that one disaster does not fill the page.
    """
    rank = driven(groups).assign(_ttc=lambda g: np.minimum(g["min_ttc"], 60.0))
    rank = rank.sort_values(["contact", "_ttc", "min_gap"], ascending=[False, True, True])
    few = rank[rank.groupby(["policy", "perturbation"]).cumcount() < 2]
    return few.head(count).drop(columns="_ttc")
