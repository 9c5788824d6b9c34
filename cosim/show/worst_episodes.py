"""The worst episodes of a batch, which its report shows."""

import numpy as np
import pandas as pd

from cosim.batch.spec import LEFT_TO_SUMO


def worst_episodes(groups: pd.DataFrame, count: int) -> pd.DataFrame:
    """The `count` worst driven groups: contacts first, then the shortest time to collision, then the smallest gap.

    At most two have the same policy and perturbation, so that several are shown.
    """
    ranked = groups[groups["policy"] != LEFT_TO_SUMO].assign(_ttc=lambda g: np.minimum(g["min_ttc"], 60.0))
    ranked = ranked.sort_values(["contact", "_ttc", "min_gap"], ascending=[False, True, True])
    shown = ranked[ranked.groupby(["policy", "perturbation"]).cumcount() < 2]
    return shown.head(count).drop(columns="_ttc")
