"""Interventions: the speed of each driver in the next step without its leader, or without requests to make room.

Each intervention runs in one copy of the simulation (`cosim.process.fork.fork`), for all vehicles at once. This is
possible because the acceleration of the first step does not depend on the accelerations of others in the same step, and
because random numbers are drawn in the same order. The copies run while the simulation goes on. Drivers that do not
decide at every step show no effect in between; `last_decisions` keeps the effect of their last decision.
"""

from collections.abc import Callable, Sequence

from cosim.process.fork import Branch, fork
from cosim.sumo import Sumo


def speeds_without_leader(
    world: Sumo, vehicles: Sequence[str], leaders: Sequence[tuple[str, str]]
) -> Branch[list[float]]:
    """Speeds [m/s] of the vehicles one step later if the first vehicle of each pair ignores the second, its leader."""
    return _speeds_after(world, vehicles, lambda: world.drivers.ignore_leaders(leaders))


def speeds_without_requests(world: Sumo, vehicles: Sequence[str], asked: Sequence[str]) -> Branch[list[float]]:
    """Speeds [m/s] of the vehicles one step later if the vehicles `asked` ignore all requests to make room."""
    return _speeds_after(world, vehicles, lambda: world.drivers.ignore_requests(asked))


def _speeds_after(world: Sumo, vehicles: Sequence[str], intervene: Callable[[], None]) -> Branch[list[float]]:
    def run() -> list[float]:
        intervene()
        world.step()
        return world.drivers.speeds(vehicles)

    return fork(run)
