"""Vehicles that wait outside the net because the road is full."""

from dataclasses import dataclass

MANY_WAITING = 20  # vehicles outside the net, from which on the road is said to be full


@dataclass(frozen=True)
class Backlog:
    """Vehicles that could not enter the net at their departure time and wait outside.

    `since` [s] is the time since which there have always been MANY_WAITING or more; None where there are fewer now.
    """

    waiting: int = 0
    since: float | None = None

    def updated(self, waiting: int, time: float) -> "Backlog":
        """The backlog after it was counted again."""
        if waiting < MANY_WAITING:
            return Backlog(waiting)
        return Backlog(waiting, time if self.since is None else self.since)
