"""Speeds of all vehicles over the last seconds, as arrays with a column per vehicle.

Positions along the way are sums of speeds, as SUMO moves vehicles. So the past of two vehicles relative to each other
is known on any net, in bends and on junctions, from their gap now.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int


class TrafficHistory:
    """The last `steps` speeds of every vehicle in the net; `update` adds one.

    A column belongs to a vehicle as long as it is in the net. A vehicle that just entered counts as having driven at
    the speed of its entry before.
    """

    def __init__(self, steps: int, dt: float) -> None:
        self._dt, self._now = dt, 0  # row of the present
        self._free: list[int] = []
        self.column_of: dict[str, int] = {}
        self.ids: tuple[str, ...] = ()
        self.columns: Int[np.ndarray, " V"] = np.zeros(0, dtype=int)
        """Column of each of `ids`."""
        self._speed, self._odometer = np.zeros((steps, 0)), np.zeros((steps, 0))
        self.a: Float[np.ndarray, " C"] = np.zeros(0)
        """Acceleration [m/s²] over the last step, by column."""

    @property
    def v(self) -> Float[np.ndarray, " C"]:
        """Speeds [m/s] now, by column."""
        return self._speed[self._now]

    def update(self, ids: tuple[str, ...], speeds: Sequence[float]) -> tuple[list[str], list[str]]:
        """Add the speeds after a step. Returns the vehicles that are new, and those that are gone."""
        came, left = [], []
        if ids != self.ids:
            present = set(ids)
            left = [vehicle for vehicle in self.ids if vehicle not in present]
            self._free += [self.column_of.pop(vehicle) for vehicle in left]
            came = [vehicle for vehicle in ids if vehicle not in self.column_of]
            for vehicle in came:
                self.column_of[vehicle] = self._free_column()
            self.ids, self.columns = ids, np.array([self.column_of[vehicle] for vehicle in ids], dtype=int)
        before, self._now = self._now, (self._now + 1) % len(self._speed)
        self._speed[self._now, self.columns] = speeds
        if came:
            self._begin([self.column_of[vehicle] for vehicle in came], before)
        self._odometer[self._now] = self._odometer[before] + self._speed[self._now] * self._dt
        self.a[:] = (self._speed[self._now] - self._speed[before]) / self._dt
        return came, left

    def _free_column(self) -> int:
        if not self._free:
            columns = len(self.a)
            more = max(columns, 64)
            self._speed, self._odometer = (np.pad(x, ((0, 0), (0, more))) for x in (self._speed, self._odometer))
            self.a = np.pad(self.a, (0, more))
            self._free = [*range(columns + more - 1, columns - 1, -1)]
        return self._free.pop()

    def _begin(self, columns: Sequence[int], before: int) -> None:
        """Let vehicles have driven at their present speed until now; `before` is the row of the last step."""
        speed, steps = self._speed[self._now, columns], len(self._speed)
        self._speed[:, columns] = speed
        ages = (before - np.arange(steps)) % steps  # [steps] of each row
        self._odometer[:, columns] = -ages[:, None] * speed * self._dt

    def past(
        self, columns: Int[np.ndarray, " P"], steps: int
    ) -> tuple[Float[np.ndarray, "P T"], Float[np.ndarray, "P T"]]:
        """Positions [m] relative to now, and speeds [m/s], at the last `steps` instants, the oldest first."""
        rows = (self._now - np.arange(steps - 1, -1, -1)) % len(self._speed)
        position = self._odometer[np.ix_(rows, columns)].T
        return position - position[:, -1:], self._speed[np.ix_(rows, columns)].T
