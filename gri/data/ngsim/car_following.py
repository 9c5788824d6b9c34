"""Car-following triples: vehicle 0 follows 1, and 1 follows 2, in one lane for T steps.

No other vehicle is between them. The hypothesised graph is the chain of the synthetic scenes (Sec. VI-D).
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from gri.data.ngsim.rules import CandidateScenes, Rules, leader_rows, splits_of
from gri.data.ngsim.smoothing import Motion


def car_following_triples(motion: Motion, rules: Rules, counts: Counter[str], vehicles: int = 3) -> np.ndarray:
    """Rows [S, N, T] of `motion` for all triples that obey the rules, ordered by follower and time.

    N is `vehicles`: other numbers than 3 give pairs or longer rows of vehicles. T is `rules.following_steps`. `counts`
    gains the number of rejected candidates for each reason.
    """
    ahead = [leader_rows(motion)]
    while len(ahead) < vehicles - 1:
        ahead.append(np.where(ahead[-1] >= 0, ahead[0][ahead[-1]], -1))
    starts, lengths = _constant_groups(motion, ahead)
    counts["together for less than T steps"] += int((lengths < rules.following_steps).sum())
    begin = np.concatenate(
        [_window_starts(motion, s, n, rules) for s, n in zip(starts.tolist(), lengths.tolist(), strict=True)]
        or [starts]
    )
    follower = begin.astype(int)[:, None] + np.arange(rules.following_steps)
    candidates = CandidateScenes(motion, np.stack([follower, *(row[follower] for row in ahead)], 1), counts)
    spacing = np.diff(candidates.column("x"), axis=1)
    candidates.reject("too far apart", (spacing >= rules.spacing).any((1, 2)))
    gap = np.diff(candidates.column("x"), axis=1) - candidates.column("length")[:, 1:]
    candidates.reject("vehicles overlap", (gap <= 0).any((1, 2)))
    candidates.reject_implausible(rules, slice(0, vehicles))
    candidates.reject_mixed_splits(rules)
    return candidates.rows


def _constant_groups(motion: Motion, ahead: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Starts and lengths of the runs of rows in which a vehicle keeps its lane and all vehicles ahead.

    `ahead` has the rows [R] of the first vehicle ahead, of the second one, and so on; −1 where there is none.
    """
    complete = ahead[-1] >= 0
    keys = np.stack([motion.track, motion.lane, *(np.where(complete, motion.track[row], -1) for row in ahead)], 1)
    starts = np.flatnonzero(np.r_[True, (np.diff(keys, axis=0) != 0).any(1)] if len(keys) else [])
    lengths = np.diff(np.r_[starts, len(keys)])
    return starts[complete[starts]], lengths[complete[starts]]


def _window_starts(motion: Motion, start: int, length: int, rules: Rules) -> np.ndarray:
    """First rows of the windows of T steps in a run. Windows overlap in the training split only."""
    training = splits_of(motion.vehicle[start : start + 1], rules)[0] == "train"
    stride = rules.training_stride if training else rules.stride or rules.following_steps
    return np.arange(start, start + length - rules.following_steps + 1, stride)
