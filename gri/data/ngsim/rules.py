"""The rules by which candidate scenes are selected from a recording."""

from collections import Counter

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from gri.data.ngsim.smoothing import Motion, Smoothing
from gri.errors import InputError

FREEWAYS = ("us-101", "i-80")
SPLITS = ("test",) * 2 + ("train",) * 7 + ("validation",)
"""Splits of ten successive blocks of vehicles."""


class Rules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The rules' parameters. A candidate that breaks rules is counted under the first rule that it breaks."""

    smoothing: Smoothing = Smoothing()
    following_steps: int = 30
    """T of car following [steps]; 30 steps of 0.2 s are 6 s."""
    changing_steps: int = 40
    """T of lane changing [steps]; 40 steps of 0.2 s are 8 s."""
    stride: int | None = None
    """Steps from one window of the same triple to the next; None: T, so windows do not overlap."""
    training_stride: int = 5
    """The same in the training split, in which windows may overlap."""
    changing_stride: int | None = 5
    """The same for lane changes, so that one lane change gives several windows; None: one window each."""
    spacing: float = 50.0
    """Vehicles interact: the distance to the vehicle ahead, front to front, is less than this [m].

    Car following requires it at all steps, lane changing at the first step and at the crossing.
    """
    travel: float = 5.0
    """Vehicle 0 travels at least this far [m]."""
    swerve: float = 1.2
    """A vehicle that keeps its lane has a range of lateral positions of at most this [m]."""
    overshoot: float = 1.0
    """A vehicle that changes lanes has a lateral path longer than its net displacement by at most this [m]."""
    acceleration: float = 6.0
    """Largest absolute longitudinal acceleration [m/s²]."""
    lanes: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    """Through lanes and auxiliary lanes. Scenes on ramps and shoulders are rejected."""
    crossing: tuple[int, int] = (8, 32)
    """First and last step at which vehicle 0 may cross into the other lane."""
    drawn: int = 2
    """Lane changes with sampled lateral motion per car-following scene of T = `changing_steps`; never for testing."""
    seed: int = 0
    """Seed of the sampled lateral motion."""
    block: int = 100
    """Vehicles are assigned to splits in blocks of so many successive numbers; 0: all are for testing."""

    def checked(self) -> "Rules":
        """These rules. Errors: `InputError` if their values contradict each other or are out of range."""
        window, order = self.smoothing.window, self.smoothing.order
        if window % 2 == 0 or not 1 <= order < window:
            raise InputError(
                f"got a smoothing window of {window} frames and degree {order}, wanted an odd window and a degree "
                "of at least 1 and less than the window"
            )
        if self.training_stride < 1 or self.spacing <= 0:
            raise InputError(f"got stride {self.training_stride}, spacing {self.spacing}, wanted both above 0")
        return self


def splits_of(vehicle: np.ndarray, rules: Rules) -> np.ndarray:
    """Split of each vehicle number: `train`, `validation` or `test`; any shape.

    Of ten successive blocks of numbers, two are for testing, seven for training and one for validation. Vehicles are
    numbered as they enter, so a block is also a period of time. A vehicle that is in two recordings under the same
    number is in one split.
    """
    if not rules.block:
        return np.full(vehicle.shape, "test")
    return np.array(SPLITS)[(vehicle // rules.block) % len(SPLITS)]


class CandidateScenes:
    """Candidate scenes as rows [S, N, T] of a `Motion`. Rejected candidates are removed and counted by reason."""

    def __init__(self, motion: Motion, rows: np.ndarray, counts: Counter[str]) -> None:
        self.motion, self.rows, self.counts = motion, rows, counts

    def column(self, name: str) -> np.ndarray:
        """A field of `Motion` for the candidates, [S, N, T]."""
        return getattr(self.motion, name)[self.rows]

    def reject(self, reason: str, condition: ArrayLike) -> None:
        """Remove and count the candidates for which `condition` [S] is true."""
        broken = np.asarray(condition, bool)
        self.counts[reason] += int(broken.sum())
        self.rows = self.rows[~broken]

    def reject_implausible(self, rules: Rules, lane_keepers: slice) -> None:
        """Apply the rules that all kinds of scenes share; the vehicles `lane_keepers` do not change lanes."""
        self.reject("motorcycle", (self.column("kind") == 1).any((1, 2)))
        lanes = np.isin(self.column("lane"), rules.lanes)
        self.reject("ramp or shoulder", ~lanes.all((1, 2)))
        self.reject("acceleration out of range", (np.abs(self.column("ax")) > rules.acceleration).any((1, 2)))
        swerves = np.ptp(self.column("y"), axis=2)[:, lane_keepers] > rules.swerve
        self.reject("swerving", swerves.any(1))
        self.reject("standing", np.ptp(self.column("x")[:, 0], axis=1) < rules.travel)

    def reject_mixed_splits(self, rules: Rules) -> None:
        """Reject candidates whose vehicles are in different splits."""
        split = splits_of(self.column("vehicle")[:, :, 0], rules)
        self.reject("vehicles of different splits", (split != split[:, :1]).any(1))


def leader_rows(motion: Motion) -> np.ndarray:
    """For each row [R]: the row of the next vehicle ahead in the same lane at the same step; −1 if there is none."""
    order = np.lexsort((motion.x, motion.lane, motion.step))
    follower, leader = order[:-1], order[1:]
    together = (motion.step[follower] == motion.step[leader]) & (motion.lane[follower] == motion.lane[leader])
    rows = np.full(len(motion), -1)
    rows[follower[together]] = leader[together]
    return rows
