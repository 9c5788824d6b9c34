"""How the traffic uses a net: which routes vehicles take, how many are under way, how fast they are."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import libsumo

from cosim.sumo.positions import without_shadows
from cosim.sumo.simulation import Sumo


@dataclass(frozen=True)
class NetUse:
    """What vehicles did in a simulation of some minutes."""

    routes: Mapping[tuple[str, ...], int]
    """Vehicles by route, as a tuple of edges."""
    vehicles: tuple[int, ...]
    """Vehicles in the net, once every `SAMPLE` seconds."""
    waiting: int
    """Vehicles that wait for room to enter, at the end."""
    speed: Mapping[str, float]
    """Mean speed [m/s] of the vehicles on each edge that was used, over time."""


SAMPLE = 10.0  # [s] between two looks at the net


def observe_net_use(world: Sumo, steps: int, dt: float, tell: Callable[[str, int, int], None]) -> NetUse:
    """Run the simulation for `steps` of `dt` [s] and count; `tell` is called with (stage, done, total)."""
    routes: Counter[tuple[str, ...]] = Counter()
    vehicles, sums, seen = [], Counter[str](), Counter[str]()
    every = max(round(SAMPLE / dt), 1)
    for k in range(1, steps + 1):
        world.step()
        for vehicle in without_shadows(libsumo.simulation.getDepartedIDList()):
            routes[tuple(libsumo.vehicle.getRoute(vehicle))] += 1
        if k % every == 0:
            tell("traffic", k, steps)
            vehicles.append(libsumo.vehicle.getIDCount())
            for edge in libsumo.edge.getIDList():
                if count := libsumo.edge.getLastStepVehicleNumber(edge):
                    sums[edge] += count * libsumo.edge.getLastStepMeanSpeed(edge)
                    seen[edge] += count
    return NetUse(routes, tuple(vehicles), world.waiting(), {edge: sums[edge] / seen[edge] for edge in seen})
