"""A cache of values that do not change while the simulation runs."""

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


class CachedVehicleValues(dict[str, T]):
    """A constant value per vehicle, read from SUMO only once."""

    def __init__(self, ask: Callable[[str], T]) -> None:
        super().__init__()
        self._ask = ask

    def __missing__(self, vehicle: str) -> T:
        self[vehicle] = found = self._ask(vehicle)
        return found
