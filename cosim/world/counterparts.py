"""How far a driven group changed what it should not: comparison with its counterpart, the same group left to SUMO."""

import numpy as np

from cosim.world.episode import Episode


def leader_deviation(driven: Episode, counterpart: Episode) -> float:
    """Largest distance [m] along the road between the leader and itself in the counterpart, from the take-over on.

    Until the first of both drives ends, or another vehicle joins one of both groups. 0 where the group is isolated and
    no perturbation changes the leader, NaN where the leader is gone from the start.
    """
    until = min(driven.end, counterpart.end) + 1e-6
    n = min(len(driven.time), len(counterpart.time))
    compared = driven.during_drive[:n] & (driven.time[:n] <= until)
    compared &= driven.valid[:n, -1] & counterpart.valid[:n, -1] & driven.unchanged[:n] & counterpart.unchanged[:n]
    apart = np.abs(driven.feature("s")[:n, -1] - counterpart.feature("s")[:n, -1])[compared]
    return float(apart.max()) if len(apart) else np.nan
