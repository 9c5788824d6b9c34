"""Car-following triples: vehicle 0 follows 1, and 1 follows 2, in one lane for T steps.

No other vehicle is between them. The hypothesised graph is the chain of the synthetic scenes (Sec. VI-D).
"""

from collections import Counter

import numpy as np

from gri.data.ngsim.rules import CandidateScenes, Rules, leader_rows, splits_of
from gri.data.ngsim.smoothing import Motion


def car_following_triples(motion: Motion, rules: Rules, counts: Counter[str]) -> np.ndarray:
    """Rows [S, 3, T] of `motion` for all triples that obey the rules, ordered by follower and time.

    T is `rules.following_steps`. `counts` gains the number of rejected candidates for each reason.
    """
    leader = leader_rows(motion)
    second_leader = np.where(leader >= 0, leader[leader], -1)
    starts, lengths = _constant_triples(motion, leader, second_leader)
    counts["together for less than T steps"] += int((lengths < rules.following_steps).sum())
    begin = np.concatenate(
        [_window_starts(motion, s, n, rules) for s, n in zip(starts.tolist(), lengths.tolist(), strict=True)]
        or [starts]
    )
    follower = begin.astype(int)[:, None] + np.arange(rules.following_steps)
    candidates = CandidateScenes(motion, np.stack([follower, leader[follower], second_leader[follower]], 1), counts)
    spacing = np.diff(candidates.column("x"), axis=1)
    candidates.reject("too far apart", (spacing >= rules.spacing).any((1, 2)))
    gap = np.diff(candidates.column("x"), axis=1) - candidates.column("length")[:, 1:]
    candidates.reject("vehicles overlap", (gap <= 0).any((1, 2)))
    candidates.reject_implausible(rules, slice(0, 3))
    candidates.reject_mixed_splits(rules)
    return candidates.rows


def _constant_triples(motion: Motion, leader: np.ndarray, second_leader: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and lengths of the runs of rows in which a vehicle keeps its lane and both vehicles ahead."""
    complete = second_leader >= 0
    ahead = (np.where(complete, motion.track[row], -1) for row in (leader, second_leader))
    keys = np.stack([motion.track, motion.lane, *ahead], 1)
    starts = np.flatnonzero(np.r_[True, (np.diff(keys, axis=0) != 0).any(1)] if len(keys) else [])
    lengths = np.diff(np.r_[starts, len(keys)])
    return starts[complete[starts]], lengths[complete[starts]]


def _window_starts(motion: Motion, start: int, length: int, rules: Rules) -> np.ndarray:
    """First rows of the windows of T steps in a run. Windows overlap in the training split only."""
    training = splits_of(motion.vehicle[start : start + 1], rules)[0] == "train"
    stride = rules.training_stride if training else rules.stride or rules.following_steps
    return np.arange(start, start + length - rules.following_steps + 1, stride)
