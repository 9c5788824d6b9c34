"""What makes a scene: the rules by which recordings are searched and candidates are turned down."""

from collections import Counter

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from gri.data.ngsim.smoothing import Motion, Smoothing
from gri.errors import InputError

FREEWAYS = ("us-101", "i-80")
SPLITS = ("test",) * 2 + ("train",) * 7 + ("validation",)


class Rules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Rules and their numbers; every candidate that breaks one is counted under the first it breaks."""

    smoothing: Smoothing = Smoothing()
    following_steps: int = 30
    """T of car following: 6 s of 0.2 s."""
    changing_steps: int = 40
    """T of lane changing: 8 s."""
    stride: int | None = None
    """Steps from one window of the same three followers to the next; None: T, so that none overlap."""
    training_stride: int = 5
    """The same in the training split, where overlap does no harm."""
    changing_stride: int | None = 5
    """The same for lane changes, of which every one gives several windows; None: one."""
    spacing: float = 50.0
    """Interactive: front to front less than this to the vehicle ahead, always when following, at the first step and at
    the crossing when changing lanes [m]."""
    travel: float = 5.0
    """Interactive: vehicle 0 moves at least this far [m]."""
    swerve: float = 1.2
    """Who keeps the lane moves sideways by no more than this [m]."""
    overshoot: float = 1.0
    """Who changes lanes moves sideways by no more than this beyond the net shift [m]."""
    acceleration: float = 6.0
    """Nobody accelerates or brakes harder [m/s²]."""
    lanes: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    """Through and auxiliary lanes; ramps and shoulders are left out."""
    crossing: tuple[int, int] = (8, 32)
    """First and last step at which the lane may be changed."""
    drawn: int = 2
    """Lane changes with drawn lateral motion, never for testing, per car-following scene of their length; 0: none."""
    seed: int = 0
    """Of what is drawn."""
    block: int = 100
    """Vehicles whose number divided by this is the same are in the same split."""

    def checked(self) -> "Rules":
        """These rules. Errors: `InputError` where they cannot be used."""
        window, order = self.smoothing.window, self.smoothing.order
        if window % 2 == 0 or not 1 <= order < window:
            raise InputError(
                f"got smoothing over {window} frames with degree {order}, wanted an odd window and a lower degree of 1 "
                "or more"
            )
        if self.training_stride < 1 or self.spacing <= 0:
            raise InputError(f"got stride {self.training_stride}, spacing {self.spacing}, wanted both above 0")
        return self


def splits_of(vehicle: np.ndarray, rules: Rules) -> np.ndarray:
    """Split of each vehicle. Numbers count vehicles as they come, so that a block is also a stretch of time.

    Of ten blocks in a row two are for testing, seven for training, one for validation. Nothing but the number counts:
    where two recordings show the same vehicle under its number, it is in one split.
    """
    return np.array(SPLITS)[(vehicle // rules.block) % len(SPLITS)]


class SceneFilter:
    """Candidates that are still in: rows [S, N, T] of a `Motion`; every rejection is counted under its reason."""

    def __init__(self, motion: Motion, rows: np.ndarray, counts: Counter[str]) -> None:
        self.motion, self.rows, self.counts = motion, rows, counts

    def of(self, name: str) -> np.ndarray:
        """A column of the candidates, [S, N, T]."""
        return getattr(self.motion, name)[self.rows]

    def reject(self, reason: str, condition: ArrayLike) -> None:
        """Drop the candidates that break a rule: condition [S]."""
        broken = np.asarray(condition, bool)
        self.counts[reason] += int(broken.sum())
        self.rows = self.rows[~broken]

    def plausible(self, rules: Rules, kept_lane: slice) -> None:
        """The rules that all kinds of scenes share; `kept_lane`: the vehicles that do not change lanes."""
        self.reject("motorcycle", (self.of("kind") == 1).any((1, 2)))
        lanes = np.isin(self.of("lane"), rules.lanes)
        self.reject("ramp or shoulder", ~lanes.all((1, 2)))
        self.reject("acceleration out of range", (np.abs(self.of("ax")) > rules.acceleration).any((1, 2)))
        swerves = np.ptp(self.of("y"), axis=2)[:, kept_lane] > rules.swerve
        self.reject("swerving", swerves.any(1))
        self.reject("standing", np.ptp(self.of("x")[:, 0], axis=1) < rules.travel)

    def one_split(self, rules: Rules) -> None:
        split = splits_of(self.of("vehicle")[:, :, 0], rules)
        self.reject("vehicles of different splits", (split != split[:, :1]).any(1))


def ahead_of(motion: Motion) -> np.ndarray:
    """Row of the next vehicle ahead in the same lane at the same step; −1 where there is none."""
    order = np.lexsort((motion.x, motion.lane, motion.step))
    behind, front = order[:-1], order[1:]
    together = (motion.step[behind] == motion.step[front]) & (motion.lane[behind] == motion.lane[front])
    ahead = np.full(len(motion), -1)
    ahead[behind[together]] = front[together]
    return ahead
