"""Lane-changing groups: vehicle 0 changes to the lane next to it, once, among two vehicles that stay in that lane.

Two readings of the paper's hypothesised graph (Sec. VI-D: a vehicle yields to its preceding vehicle in the neighbouring
lane and follows its preceding vehicle in the same lane; the leader is the last vehicle):

- H1: 0 merges behind 1, which follows 2. 1 → 0: yield, 2 → 1: follow.
- H2: 0 merges between 1, which lags, and 2, which leads. 2 → 0: yield, 0 → 1: yield, 2 → 1: follow.

Lanes are read at the first step, as the graph does not change. Partners are the nearest vehicles, at the crossing, that
are seen in the target lane at all T steps; vehicles that are not seen throughout cannot be partners.
"""

from collections import Counter
from typing import Literal

import numpy as np

from gri.data.ngsim.rules import Rules, SceneFilter
from gri.data.ngsim.smoothing import Motion
from gri.networks.model import MERGE_BEHIND, MERGE_BETWEEN, Edge

Reading = Literal["H1", "H2"]
GRAPHS: dict[Reading, tuple[Edge, ...]] = {"H1": MERGE_BEHIND, "H2": MERGE_BETWEEN}


def groups(motion: Motion, rules: Rules, reading: Reading, counts: Counter[str]) -> np.ndarray:
    """Rows [S, 3, T] of all groups that keep the rules, by changer and time."""
    spans = np.flatnonzero(np.r_[True, np.diff(motion.track) != 0, True]) if len(motion) else np.zeros(1, int)
    found = []
    for crossing in _crossings(motion).tolist():
        changer = int(np.searchsorted(spans, crossing, "right")) - 1
        begins = _begins(motion, spans, changer, crossing, rules)
        counts["changer not seen for T steps around the crossing"] += not begins
        for begin in begins:
            partners = _partners(motion, spans, crossing, begin, rules, reading)
            counts["no two partners seen throughout"] += partners is None
            if partners is not None:
                found.append(np.stack([_rows(motion, spans, k, begin, rules) for k in (changer, *partners)]))
    if len(found) and np.ptp(motion.y) == 0:
        counts["lateral position not recorded"] += len(found)
        found = []
    sieve = SceneFilter(motion, np.stack(found) if found else np.zeros((0, 3, rules.changing_steps), int), counts)
    changes = (np.diff(sieve.of("lane")[:, 0], axis=1) != 0).sum(1)
    sieve.reject("several lane changes", changes != 1)
    sieve.reject("lanes not next to each other", np.ptp(sieve.of("lane")[:, 0], axis=1) != 1)
    _close(sieve, rules, reading)
    sieve.plausible(rules, slice(1, 3))
    y = sieve.of("y")[:, 0]
    sieve.reject("changer swerves", np.abs(np.diff(y)).sum(1) - np.abs(y[:, -1] - y[:, 0]) > rules.overshoot)
    sieve.one_split(rules)
    return sieve.rows


def _close(sieve: SceneFilter, rules: Rules, reading: Reading) -> None:
    """Interactive, and in the order that the graph speaks of at the first step."""
    x, lane = sieve.of("x"), sieve.of("lane")[:, 0]
    crossing = (lane != lane[:, :1]).argmax(1)
    when = np.stack([x[:, :, 0], np.take_along_axis(x, crossing[:, None, None], 2)[:, :, 0]], 1)
    order = [0, 1, 2] if reading == "H1" else [1, 0, 2]
    headway = np.diff(when[:, :, order], axis=2)  # Shape: (S, first step or crossing, pair)
    far = (np.abs(headway) >= rules.spacing).any((1, 2))
    sieve.reject("too far apart", far)
    sieve.reject("in another order at the first step", (headway[~far, 0] <= 0).any(1))


def _crossings(motion: Motion) -> np.ndarray:
    """Rows at which a vehicle is first seen in another lane."""
    same = np.r_[False, np.diff(motion.track) == 0]
    return np.flatnonzero(same & np.r_[False, np.diff(motion.lane) != 0])


def _begins(motion: Motion, spans: np.ndarray, changer: int, crossing: int, rules: Rules) -> list[int]:
    """First steps of windows in which the changer is seen: the crossing nearest the middle, and strides from there."""
    steps, (low, high), at = rules.changing_steps, rules.crossing, int(motion.step[crossing])
    first = max(int(motion.step[spans[changer]]), at - high)
    last = min(int(motion.step[spans[changer + 1] - 1]) - steps + 1, at - low)
    middle, stride = min(max(at - steps // 2, first), last), rules.changing_stride or steps
    return list(range(middle - (middle - first) // stride * stride, last + 1, stride)) if first <= last else []


def _partners(
    motion: Motion, spans: np.ndarray, crossing: int, begin: int, rules: Rules, reading: Reading
) -> tuple[int, int] | None:
    """Indices of the tracks of vehicles 1 and 2; None where one is missing."""
    lane, at = motion.lane[crossing], motion.step[crossing]
    starts, ends = spans[:-1], spans[1:] - 1
    seen = (motion.step[starts] <= begin) & (motion.step[ends] >= begin + rules.changing_steps - 1)
    kept = [k for k in np.flatnonzero(seen) if (motion.lane[_rows(motion, spans, int(k), begin, rules)] == lane).all()]
    places = np.array([motion.x[starts[k] + at - motion.step[starts[k]]] for k in kept]) - motion.x[crossing]
    order = [int(kept[i]) for i in np.argsort(places)]
    behind = int((places <= 0).sum())
    chosen = order[behind : behind + 2] if reading == "H1" else order[max(behind - 1, 0) : behind + 1]
    whole = len(chosen) == 2 and (reading == "H1" or behind > 0)
    return (chosen[0], chosen[1]) if whole else None


def _rows(motion: Motion, spans: np.ndarray, track: int, begin: int, rules: Rules) -> np.ndarray:
    """Rows of a track's T steps from `begin`."""
    return spans[track] + begin - motion.step[spans[track]] + np.arange(rules.changing_steps)
