"""Lane-changing groups: vehicle 0 changes once to an adjacent lane, in which vehicles 1 and 2 stay.

The paper's hypothesised graph is: a vehicle yields to its preceding vehicle in the adjacent lane, and follows its
preceding vehicle in the same lane (Sec. VI-D). Vehicle 2 is the leader. The paper does not say which vehicles these
are, so there are two hypotheses:

- H1: 0 merges behind 1, and 1 follows 2. 1 → 0: yield, 2 → 1: follow.
- H2: 0 merges between the lag vehicle 1 and the leader 2. 2 → 0: yield, 0 → 1: yield, 2 → 1: follow.

The graph does not change over time, so the lanes at the first step determine it. Vehicles 1 and 2, the partners, are
the vehicles nearest to vehicle 0 when it crosses. Only vehicles that are in the target lane at all T steps can be
partners.
"""

from collections import Counter
from typing import Literal

import numpy as np

from gri.data.ngsim.rules import CandidateScenes, Rules
from gri.data.ngsim.smoothing import Motion
from gri.networks.model import MERGE_BEHIND, MERGE_BETWEEN, Edge

Hypothesis = Literal["H1", "H2"]
HYPOTHESISED_GRAPHS: dict[Hypothesis, tuple[Edge, ...]] = {"H1": MERGE_BEHIND, "H2": MERGE_BETWEEN}


def lane_change_groups(motion: Motion, rules: Rules, hypothesis: Hypothesis, counts: Counter[str]) -> np.ndarray:
    """Rows [S, 3, T] of `motion` for all groups that obey the rules, ordered by vehicle 0 and time.

    T is `rules.changing_steps`. `counts` gains the number of rejected candidates for each reason.
    """
    bounds = np.flatnonzero(np.r_[True, np.diff(motion.track) != 0, True]) if len(motion) else np.zeros(1, int)
    found = []
    for crossing in _crossings(motion).tolist():
        changer = int(np.searchsorted(bounds, crossing, "right")) - 1
        starts = _window_starts(motion, bounds, changer, crossing, rules)
        counts["changer not seen for T steps around the crossing"] += not starts
        for start in starts:
            partners = _partners(motion, bounds, crossing, start, rules, hypothesis)
            counts["no two partners seen throughout"] += partners is None
            if partners is not None:
                found.append(np.stack([_rows(motion, bounds, k, start, rules) for k in (changer, *partners)]))
    if len(found) and np.ptp(motion.y) == 0:
        counts["lateral position not recorded"] += len(found)
        found = []
    rows = np.stack(found) if found else np.zeros((0, 3, rules.changing_steps), int)
    candidates = CandidateScenes(motion, rows, counts)
    changes = (np.diff(candidates.column("lane")[:, 0], axis=1) != 0).sum(1)
    candidates.reject("several lane changes", changes != 1)
    candidates.reject("lanes not next to each other", np.ptp(candidates.column("lane")[:, 0], axis=1) != 1)
    _reject_not_interacting(candidates, rules, hypothesis)
    candidates.reject_implausible(rules, slice(1, 3))
    y = candidates.column("y")[:, 0]
    candidates.reject("changer swerves", np.abs(np.diff(y)).sum(1) - np.abs(y[:, -1] - y[:, 0]) > rules.overshoot)
    candidates.reject_mixed_splits(rules)
    return candidates.rows


def _reject_not_interacting(candidates: CandidateScenes, rules: Rules, hypothesis: Hypothesis) -> None:
    """Reject groups that are far apart, or not in the hypothesis's order along the road at the first step."""
    x, lane = candidates.column("x"), candidates.column("lane")[:, 0]
    crossing = (lane != lane[:, :1]).argmax(1)
    instants = np.stack([x[:, :, 0], np.take_along_axis(x, crossing[:, None, None], 2)[:, :, 0]], 1)
    order = [0, 1, 2] if hypothesis == "H1" else [1, 0, 2]
    spacing = np.diff(instants[:, :, order], axis=2)  # Shape: (S, first step or crossing, pair)
    far = (np.abs(spacing) >= rules.spacing).any((1, 2))
    candidates.reject("too far apart", far)
    candidates.reject("in another order at the first step", (spacing[~far, 0] <= 0).any(1))


def _crossings(motion: Motion) -> np.ndarray:
    """Rows at which a vehicle is in another lane than one step before."""
    same = np.r_[False, np.diff(motion.track) == 0]
    return np.flatnonzero(same & np.r_[False, np.diff(motion.lane) != 0])


def _window_starts(motion: Motion, bounds: np.ndarray, changer: int, crossing: int, rules: Rules) -> list[int]:
    """First steps of the windows of T steps with the crossing in the range `rules.crossing`; vehicle 0 is in all steps.

    One window has the crossing as near to its middle as possible. The others are multiples of the stride away.
    """
    steps, (low, high), crossing_step = rules.changing_steps, rules.crossing, int(motion.step[crossing])
    first = max(int(motion.step[bounds[changer]]), crossing_step - high)
    last = min(int(motion.step[bounds[changer + 1] - 1]) - steps + 1, crossing_step - low)
    middle, stride = min(max(crossing_step - steps // 2, first), last), rules.changing_stride or steps
    return list(range(middle - (middle - first) // stride * stride, last + 1, stride)) if first <= last else []


def _partners(
    motion: Motion, bounds: np.ndarray, crossing: int, start: int, rules: Rules, hypothesis: Hypothesis
) -> tuple[int, int] | None:
    """Indices of the tracks of vehicles 1 and 2; None if one does not exist."""
    lane, crossing_step = motion.lane[crossing], motion.step[crossing]
    first, last = bounds[:-1], bounds[1:] - 1
    present = (motion.step[first] <= start) & (motion.step[last] >= start + rules.changing_steps - 1)
    in_lane = [
        k for k in np.flatnonzero(present) if (motion.lane[_rows(motion, bounds, int(k), start, rules)] == lane).all()
    ]
    ahead = np.array([motion.x[first[k] + crossing_step - motion.step[first[k]]] for k in in_lane]) - motion.x[crossing]
    order = [int(in_lane[i]) for i in np.argsort(ahead)]
    behind = int((ahead <= 0).sum())
    chosen = order[behind : behind + 2] if hypothesis == "H1" else order[max(behind - 1, 0) : behind + 1]
    complete = len(chosen) == 2 and (hypothesis == "H1" or behind > 0)
    return (chosen[0], chosen[1]) if complete else None


def _rows(motion: Motion, bounds: np.ndarray, track: int, start: int, rules: Rules) -> np.ndarray:
    """Rows [T] of a track from the step `start` on."""
    return bounds[track] + start - motion.step[bounds[track]] + np.arange(rules.changing_steps)
