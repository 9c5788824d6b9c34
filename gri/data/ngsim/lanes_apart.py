"""Groups of vehicles in several lanes, in which a vehicle cannot follow the next one along the road."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gri.data.ngsim.rules import CandidateScenes, Rules, leader_rows
from gri.data.ngsim.smoothing import Motion


@dataclass(frozen=True)
class _Together:
    """The V vehicles that keep their lanes for all T steps of one window."""

    rows: np.ndarray
    """Rows of the motion, [V, T]."""
    x: np.ndarray
    """[V, T]"""
    lane: np.ndarray
    """[V]"""

    def next_ahead(self, vehicle: int, lanes: np.ndarray, headway: tuple[float, float]) -> int | None:
        """The nearest vehicle in these lanes whose headway to `vehicle` is in the range all along."""
        distance = self.x - self.x[vehicle]
        fine = ((distance >= headway[0]) & (distance <= headway[1])).all(1) & np.isin(self.lane, lanes)
        found = np.flatnonzero(fine)
        return int(found[distance[found, 0].argmin()]) if len(found) else None


def in_different_lanes(motion: Motion, vehicles: int, rules: Rules, headway: tuple[float, float]) -> np.ndarray:
    """Rows [S, N, T] of N vehicles in N different lanes, each within `headway` [m] ahead of the one before."""
    found = []
    for known in _windows(motion, rules):
        lanes = np.unique(known.lane)
        for first in range(len(known.rows)):
            group: list[int] = [first]
            while len(group) < vehicles:
                following = known.next_ahead(group[-1], np.setdiff1d(lanes, known.lane[group]), headway)
                if following is None:
                    break
                group.append(following)
            if len(group) == vehicles:
                found.append(known.rows[group])
    return _plausible(motion, found, vehicles, rules)


def one_between_in_next_lane(motion: Motion, rules: Rules, headway: tuple[float, float]) -> np.ndarray:
    """Rows [S, 3, T]: vehicle 0 follows 2 in one lane; vehicle 1 is between them, in the next lane."""
    leader, found = leader_rows(motion), []
    for known in _windows(motion, rules):
        for first in range(len(known.rows)):
            ahead = leader[known.rows[first]]
            second = np.flatnonzero((known.rows == ahead).all(1))
            beside = known.lane[first] + np.array([-1, 1])
            between = known.next_ahead(first, beside, headway) if len(second) else None
            if between is not None and (known.x[second[0]] - known.x[between] >= headway[0]).all():
                found.append(known.rows[[first, between, second[0]]])
    return _plausible(motion, found, 3, rules)


def _windows(motion: Motion, rules: Rules) -> Iterator[_Together]:
    """All windows of T steps of a recording, `rules.stride` or T steps apart."""
    steps = rules.following_steps
    if not len(motion):
        return
    keys = np.stack([motion.track, motion.lane], 1)
    starts = np.flatnonzero(np.r_[True, (np.diff(keys, axis=0) != 0).any(1)])
    ends = np.r_[starts[1:], len(keys)] - 1
    for begin in range(int(motion.step.min()), int(motion.step.max()) - steps + 2, rules.stride or steps):
        present = (motion.step[starts] <= begin) & (motion.step[ends] >= begin + steps - 1)
        rows = starts[present, None] + begin - motion.step[starts[present], None] + np.arange(steps)
        yield _Together(rows, motion.x[rows], motion.lane[rows[:, 0]])


def _plausible(motion: Motion, found: list[np.ndarray], vehicles: int, rules: Rules) -> np.ndarray:
    rows = np.stack(found) if found else np.zeros((0, vehicles, rules.following_steps), int)
    candidates = CandidateScenes(motion, rows, Counter())
    candidates.reject_implausible(rules, slice(0, vehicles))
    candidates.reject_mixed_splits(rules)
    return candidates.rows
