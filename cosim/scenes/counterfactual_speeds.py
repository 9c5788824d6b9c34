"""What drivers would do in the next step without their leader, or without requests to make room.

Each is one copy of the simulation (`cosim.process.fork.fork`) for all vehicles at once: accelerations of the first step
after an intervention do not depend on those of others, and random numbers are drawn in the same order. The copies run
while the simulation goes on.
"""

from collections.abc import Callable, Sequence

from cosim.process.fork import Branch, fork
from cosim.sumo import Sumo


def speeds_without_leader(
    world: Sumo, vehicles: Sequence[str], leaders: Sequence[tuple[str, str]]
) -> Branch[list[float]]:
    """Speeds [m/s] of the vehicles one step later if, of each pair, the first did not see the second ahead of it."""
    return _stepped(world, vehicles, lambda: world.drivers.ignore(leaders))


def speeds_without_requests(world: Sumo, vehicles: Sequence[str], asked: Sequence[str]) -> Branch[list[float]]:
    """Speeds [m/s] of the vehicles one step later if the asked ones did not slow down for who wants to change lanes."""
    return _stepped(world, vehicles, lambda: world.drivers.ignore_requests(asked))


def _stepped(world: Sumo, vehicles: Sequence[str], intervene: Callable[[], None]) -> Branch[list[float]]:
    def run() -> list[float]:
        intervene()
        world.step()
        return world.drivers.speeds(vehicles)

    return fork(run)
