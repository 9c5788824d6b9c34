"""How long work tells how far it is."""

from collections.abc import Callable

Progress = Callable[[str, int, int, float], None]
"""(what is trained, updates done, updates in all, value of its objective)."""


def no_progress(what: str, done: int, total: int, value: float) -> None:
    """No progress shown."""
