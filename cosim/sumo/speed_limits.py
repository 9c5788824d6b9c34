"""Reading the mean speed on edges, and setting the speed limits of lanes."""

from collections.abc import Sequence

import libsumo


def speeds_on(edges: Sequence[str]) -> tuple[float, float]:
    """The sum of the speeds [m/s] of the vehicles on these edges in the last step, and their number."""
    counts = [libsumo.edge.getLastStepVehicleNumber(edge) for edge in edges]
    means = [libsumo.edge.getLastStepMeanSpeed(edge) for edge in edges]
    return sum(n * v for n, v in zip(counts, means, strict=True)), float(sum(counts))


def set_limits(lanes: Sequence[str], limits: Sequence[float]) -> None:
    """Set the speed limit [m/s] of each lane, from the next step on."""
    for lane, limit in zip(lanes, limits, strict=True):
        libsumo.lane.setMaxSpeed(lane, limit)
