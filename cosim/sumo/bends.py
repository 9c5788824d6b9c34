"""Slowing SUMO's drivers before bends on a slippery road, so that they stay inside the friction circle."""

import math

import libsumo
import numpy as np

from cosim.world.road_frame import RoadFrame

GRAVITY = 9.81  # [m/s^2]
LATERAL_SHARE = 0.5  # of the friction, which drivers use in a bend; the rest is left for braking
SPACING = 5.0  # [m] between two places at which the curvature of a lane is measured


def slow_before_bends(friction: float) -> None:
    """Lower the limit of every lane on which the fastest driver would have a lateral acceleration above half of μ·g.

    If there is such a lane, the drivers' acceleration and braking are at most √(1 − 0.5²)·μ·g, so that both together
    stay below μ·g. A bottleneck's speed signs replace the limits of their lanes.
    """
    limit, types = friction * GRAVITY, libsumo.vehicletype
    fastest = max((types.getSpeedFactor(kind) for kind in types.getIDList()), default=1.0)
    slowed = False
    for lane in libsumo.lane.getIDList():
        curvature = greatest_curvature(np.array(libsumo.lane.getShape(lane), dtype=float))
        speed = math.sqrt(LATERAL_SHARE * limit / curvature) / fastest if curvature > 1e-6 else math.inf
        if speed < libsumo.lane.getMaxSpeed(lane):
            libsumo.lane.setMaxSpeed(lane, speed)
            slowed = True
    if slowed:
        along = math.sqrt(1 - LATERAL_SHARE**2) * limit
        for kind in types.getIDList():
            types.setAccel(kind, min(types.getAccel(kind), along))
            types.setDecel(kind, min(types.getDecel(kind), along))
            types.setApparentDecel(kind, min(types.getApparentDecel(kind), along))
            types.setEmergencyDecel(kind, min(types.getEmergencyDecel(kind), along))


def greatest_curvature(shape: np.ndarray) -> float:
    """The greatest curvature [1/m] of a polyline of shape (P, 2), in either direction."""
    road = RoadFrame(shape)
    length = float(np.hypot(*np.diff(shape, axis=0).T).sum())
    places = np.arange(0.0, length + SPACING, SPACING)
    return float(np.abs(road.curvature_at(places, np.zeros_like(places))).max())
