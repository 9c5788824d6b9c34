"""A grid of cut-ins: ego speed × speed of the other × gap × lateral speed, each cell driven for 35 s.

Both cars are 4.3 m × 1.9 m. The other starts in the lane beside the ego's, 3.5 m between the centres, `gap` ahead, and
moves over at a constant lateral speed until it is in front of the ego. Its lateral speed has risen before that with
1.5 m/s², and the ego is in control during this ramp as well. The ego stays in its lane and never drives faster than at
the start. A collision is an overlap of both cars; what comes after it does not matter.

In some cells a limit is met exactly (a TTC of 2.0 s, sides that touch), and the rounding of binary fractions decides.
The order of operations below is therefore part of the definition.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from gri.errors import InputError
from gri.reference_drivers.drivers import ReferenceDriver, Situation
from gri.reference_drivers.reaction import Reaction, react

LENGTH, WIDTH = 4.3, 1.9  # [m] of both cars
LANE = 3.5  # [m] between the centres of the two lanes
LATERAL_ACCELERATION = 1.5  # [m/s²] of the other, before the clock starts
RATE = 10  # steps per second
STEPS = 350  # after the ramp
KMH = 3.6  # km/h per m/s
MOST_CELLS = 1_000_000
Values = Sequence[int] | Sequence[float] | Sequence[int | float]


@dataclass(frozen=True)
class Grid:
    """C cells in one order: speeds in km/h, gap in m, lateral speed in m/s."""

    ego: Float[np.ndarray, " C"]
    other: Float[np.ndarray, " C"]
    gap: Float[np.ndarray, " C"]
    lateral: Float[np.ndarray, " C"]

    @classmethod
    def of(
        cls,
        ego: Values,
        other: Values,
        gap: Values,
        lateral: Values,
    ) -> "Grid":
        """All combinations in which the other is slower than the ego.

        Raises:
            InputError: there are none, too many, or values that no cut-in can have.
        """
        count = len(ego) * len(other) * len(gap) * len(lateral)
        if count > MOST_CELLS:
            raise InputError(f"grid: got {count:,} cells, expected at most {MOST_CELLS:,}; use wider steps")
        pairs = [(own, slower) for own in ego for slower in other if slower < own]
        if not pairs or not len(gap) or not len(lateral):
            raise InputError("grid: got no cell in which the other is slower than the ego; widen the ranges")
        if min(other) < 0 or min(gap) <= 0 or min(lateral) < 0:
            raise InputError("grid: got a speed below 0 or a gap of 0 or less; expected speeds from 0 and gaps above 0")
        if max(ego) > 400 or max(gap) > 10_000 or max(lateral) > 10:
            raise InputError("grid: got an ego above 400 km/h, a gap above 10 km or a lateral speed above 10 m/s")
        return cls(*np.array([(*pair, x, c) for pair in pairs for x in gap for c in lateral], dtype=float).T)

    def __len__(self) -> int:
        return len(self.ego)

    def __getitem__(self, cells: Bool[np.ndarray, " C"] | Int[np.ndarray, " S"] | slice) -> "Grid":
        """Some of the cells."""
        return Grid(self.ego[cells], self.other[cells], self.gap[cells], self.lateral[cells])


EGOS = {"low": range(20, 61, 10), "high": range(70, 131, 20)}  # [km/h]
OTHERS = {"low": range(10, 51, 10), "high": range(10, 101, 30)}  # [km/h]
GAPS = {"low": range(1, 60), "high": range(1, 120, 2)}  # [m]
LATERALS = tuple(0.1 * k for k in range(18))  # [m/s]


def usual_grid(speeds: str) -> Grid:
    """The grid of "low" speeds with 15,930 cells, or of "high" speeds with 14,040 cells."""
    return Grid.of(EGOS[speeds], OTHERS[speeds], GAPS[speeds], LATERALS)


@dataclass(frozen=True)
class OtherCar:
    """The path of the other in every cell: T instants, of which those before `start` do not exist in a cell.

    `across` [m] is the lateral distance between the centres, `speed` [m/s] the lateral speed towards the ego, `along`
    [m] the position of the centre along the road. The ego's centre is at x = 0 at the instant `ramp`.
    """

    across: Float[np.ndarray, "T C"]
    speed: Float[np.ndarray, "T C"]
    along: Float[np.ndarray, "T C"]
    start: Int[np.ndarray, " C"]
    ramp: int

    @classmethod
    def of(cls, grid: Grid) -> "OtherCar":
        """The ramp of each cell, rounded up to whole steps, and STEPS after it."""
        per_step = LATERAL_ACCELERATION / RATE
        steps = np.ceil(grid.lateral / per_step).astype(int)
        ramp = int(steps.max())
        k = np.arange(-ramp, STEPS)[:, None]
        rising = np.where(k >= -steps, per_step * (k + steps), 0.0)[:ramp]
        before = LANE + np.cumsum(rising[::-1] / RATE, axis=0)[::-1]
        moved = np.cumsum(np.broadcast_to(grid.lateral, (STEPS - 1, len(grid))), axis=0) / RATE
        moving = LANE - np.concatenate([np.zeros((1, len(grid))), moved])
        constant = np.where(moving > 0, grid.lateral, 0.0)
        v = grid.other / KMH
        first = grid.gap + LENGTH - v * steps / RATE
        along = first + v * np.maximum(k + steps, 0) / RATE
        return cls(
            across=np.concatenate([before, np.maximum(moving, 0.0)]),
            speed=np.concatenate([rising, constant]),
            along=along,
            start=ramp - steps,
            ramp=ramp,
        )


@runtime_checkable
class SpeedControl(Protocol):
    """Anything that drives the ego along its lane: called once per step of 0.1 s."""

    def __call__(self, now: Situation, live: Bool[np.ndarray, " C"]) -> tuple[np.ndarray, Bool[np.ndarray, " C"]]:
        """Decelerations [m/s²], and the cells that are over without a collision; `live` are the cells under way."""
        ...


@dataclass(frozen=True)
class Driven:
    """What happened in each cell: whether the ego collided, and how much slower it got until then [m/s]."""

    collided: Bool[np.ndarray, " C"]
    slowed: Float[np.ndarray, " C"]


def drive(grid: Grid, control: SpeedControl) -> Driven:
    """Drive the egos of all cells by `control`."""
    other, cells = OtherCar.of(grid), len(grid)
    v_other, v = grid.other / KMH, grid.ego / KMH
    x = -v * (other.ramp - other.start) / RATE
    a, hit, over = np.zeros(cells), np.zeros(cells, dtype=bool), np.zeros(cells, dtype=bool)
    lengths, slowest = np.full(cells, 2 * LENGTH), v
    for k in range(len(other.along)):
        live = (k >= other.start) & ~over & ~hit
        centres, side = other.along[k] - x, other.across[k] - WIDTH / 2 - WIDTH / 2
        now = Situation(
            centres=centres,
            gap=np.abs(centres) - LENGTH / 2 - LENGTH / 2,
            side=side,
            lengths=lengths,
            v=v,
            v_other=v_other,
            approach=other.speed[k],
            wandered=LANE - other.across[k],
            a=a,
        )
        hit |= live & (now.side < 0) & (now.gap < 0)
        deceleration, ended = control(now, live)
        following = np.where(live, np.clip(v - deceleration / RATE, 0.0, grid.ego / KMH), v)
        a, v, slowest = (following - v) * RATE, following, np.minimum(slowest, following)
        x = np.where(k >= other.start, x + v / RATE, x)
        over |= live & ended
    return Driven(hit, grid.ego / KMH - slowest)


class ReferenceControl:
    """A reference driver in control of the egos: keeps the speed until it reacts, and whenever there is no risk."""

    def __init__(self, driver: ReferenceDriver, cells: int) -> None:
        self.driver, self.reaction = driver, Reaction.none(cells)

    def __call__(self, now: Situation, live: Bool[np.ndarray, " C"]) -> tuple[np.ndarray, Bool[np.ndarray, " C"]]:
        judged = self.driver.judge(now)
        judged = replace(judged, risk=judged.risk & live)
        deceleration, self.reaction = react(self.driver, judged, self.reaction, 1 / RATE)
        return deceleration, judged.settled


def drive_reference(driver: ReferenceDriver, grid: Grid) -> Driven:
    """Drive the egos of all cells by a reference driver."""
    return drive(grid, ReferenceControl(driver, len(grid)))
