"""How hard the hand-back was, as columns of a table: braking and jerk of the driven vehicles in the seconds after it.

Groups that no policy drove have the same columns, about the seconds after the time at which the rules end their drive.
"""

import numpy as np
from jaxtyping import Bool, Float

from cosim.world.episode import Episode

BRAKING_WINDOW, JERK_WINDOW = 5.0, 10.0  # [s] after the hand-back
BRAKING = 2.0, 3.0  # [m/s²], thresholds below the 3.5 that drivers of the shipped traffic are ready to use


def hand_back_columns(episode: Episode) -> dict[str, float]:
    """Hardest braking within 5 s of the hand-back [m/s²], and greatest |jerk| within 10 s of it [m/s³].

    Of the roles that a policy drives, to the end, also where the group was left to SUMO. The braking is positive, or 0
    where no vehicle brakes. The first jerk is the one from the last driven instant to the next. Not a number where none
    of the vehicles is seen after the hand-back.
    """
    roles = list(episode.kept_roles)
    seen = episode.valid[:, roles]
    before = np.vstack([np.zeros_like(seen[:1]), seen[:-1]])
    return {
        "braking_after": _greatest(-episode.feature("a")[:, roles], seen, _within(episode, BRAKING_WINDOW)),
        "jerk_after": _greatest(np.abs(episode.jerk[:, roles]), seen & before, _within(episode, JERK_WINDOW)),
    }


def _within(episode: Episode, seconds: float) -> Bool[np.ndarray, " T"]:
    """The instants after the hand-back, for some seconds."""
    return (episode.time > episode.end + 1e-6) & (episode.time <= episode.end + seconds + 1e-6)


def _greatest(value: Float[np.ndarray, "T R"], seen: Bool[np.ndarray, "T R"], when: Bool[np.ndarray, " T"]) -> float:
    found = value[seen & when[:, None]]
    return max(float(found.max()), 0.0) if len(found) else float("nan")
