"""Car-following triples: 0 behind 1 behind 2 in one lane, nobody between, for T steps.

The hypothesised graph is the chain of the synthetic scenes: 0 follows 1, and 1 follows 2 (Sec. VI-D).
"""

from collections import Counter

import numpy as np

from gri.data.ngsim.rules import Rules, SceneFilter, ahead_of, splits_of
from gri.data.ngsim.smoothing import Motion


def triples(motion: Motion, rules: Rules, counts: Counter[str]) -> np.ndarray:
    """Rows [S, 3, T] of all triples that keep the rules, by follower and time."""
    first = ahead_of(motion)
    second = np.where(first >= 0, first[first], -1)
    starts, lengths = _runs(motion, first, second)
    counts["together for less than T steps"] += int((lengths < rules.following_steps).sum())
    begin = np.concatenate(
        [_begins(motion, s, n, rules) for s, n in zip(starts.tolist(), lengths.tolist(), strict=True)] or [starts]
    )
    follower = begin.astype(int)[:, None] + np.arange(rules.following_steps)
    sieve = SceneFilter(motion, np.stack([follower, first[follower], second[follower]], 1), counts)
    headway = np.diff(sieve.of("x"), axis=1)
    sieve.reject("too far apart", (headway >= rules.spacing).any((1, 2)))
    gap = np.diff(sieve.of("x"), axis=1) - sieve.of("length")[:, 1:]
    sieve.reject("vehicles overlap", (gap <= 0).any((1, 2)))
    sieve.plausible(rules, slice(0, 3))
    sieve.one_split(rules)
    return sieve.rows


def _begins(motion: Motion, start: int, length: int, rules: Rules) -> np.ndarray:
    """First rows of the windows in a run; they overlap in the training split only."""
    training = splits_of(motion.vehicle[start : start + 1], rules)[0] == "train"
    stride = rules.training_stride if training else rules.stride or rules.following_steps
    return np.arange(start, start + length - rules.following_steps + 1, stride)


def _runs(motion: Motion, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and lengths of the rows in which a vehicle has the same two vehicles ahead in the same lane."""
    whole = second >= 0
    ahead = np.where(whole, motion.track[first], -1), np.where(whole, motion.track[second], -1)
    keys = np.stack([motion.track, motion.lane, *ahead], 1)
    begins = np.flatnonzero(np.r_[True, (np.diff(keys, axis=0) != 0).any(1)] if len(keys) else [])
    lengths = np.diff(np.r_[begins, len(keys)])
    kept = whole[begins]
    return begins[kept], lengths[kept]
