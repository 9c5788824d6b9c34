"""How long work reports its progress: as a function that it is given."""

from collections.abc import Callable

Progress = Callable[[str, int, int, float], None]
"""(stage, units done, units in all, value of the objective or 0 where there is none)."""


def no_progress(what: str, done: int, total: int, value: float) -> None:
    """Report nothing."""
