"""The function type by which long computations report their progress."""

from collections.abc import Callable

Progress = Callable[[str, int, int, float], None]
"""(stage, units done, units in all, value of the objective or 0 where there is none)."""


def no_progress(what: str, done: int, total: int, value: float) -> None:
    """Report nothing."""
