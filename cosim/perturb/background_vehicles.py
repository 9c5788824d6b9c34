"""What a perturbation makes a background vehicle do: a plan of poses, one per step, then it is SUMO's again."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from cosim.perturb.displaced_starts import Cars
from cosim.spec.perturbations import LeaderBraking, NeighbourCutIn

Steps = Float[np.ndarray, " T"]
LANE_WIDTH = 3.66  # [m], twelve feet


@dataclass(frozen=True)
class Plan:
    """Where a vehicle is to be after each step: front bumper (s, d), heading from the road [rad], speed [m/s]."""

    vehicle: str
    s: Steps
    d: Steps
    heading: Steps
    v: Steps


def _along(s: float, v: Float[np.ndarray, " U"], dt: float) -> Steps:
    """Positions after each step at speeds v[0] (now), v[1], …"""
    return s + np.cumsum(0.5 * dt * (v[1:] + v[:-1]))


def braking(vehicle: str, s: float, d: float, v: float, spec: LeaderBraking, dt: float) -> Plan:
    """Brake at the intensity for `spec.duration`, or until standing."""
    steps = round(spec.duration / dt)
    speed = np.maximum(v - spec.intensity * dt * np.arange(steps + 1), 0.0)
    return Plan(vehicle, _along(s, speed, dt), np.full(steps, d), np.zeros(steps), speed[1:])


def cutter(group: Cars, follower: int, others: Cars, spec: NeighbourCutIn) -> int | None:
    """Row of the neighbour that fits between vehicle 2 and its follower, the one nearest to that; None without one.

    It is beside the lane of vehicle 2 and, along the road, clear of both by `spec.clearance`.
    """
    low, high = group.s[follower] + spec.clearance, group.s[2] - group.length[2] - spec.clearance
    across = np.abs(others.d - group.d[2])
    beside = (across > 0.5 * LANE_WIDTH) & (across < 1.5 * LANE_WIDTH)
    fits = np.flatnonzero(beside & (others.s - others.length > low) & (others.s < high))
    return int(fits[np.argmin(others.s[fits])]) if len(fits) else None


def cutting_in(
    vehicle: str, own: tuple[float, float, float], lane: float, behind: float, spec: NeighbourCutIn, dt: float
) -> Plan:
    """Change from (s, d, v) to the lateral position `lane` and brake to `behind` [m/s] − intensity.

    Sideways it follows a half cosine in `spec.lateral_time`; the heading is the direction of travel.
    """
    s, d, v = own
    steps = round(spec.duration / dt)
    time = dt * np.arange(steps + 1)
    wanted = max(behind - spec.intensity, 0.0)
    slower = np.maximum(v - spec.deceleration * time, min(wanted, v))
    share = 0.5 * (1 - np.cos(np.pi * np.clip(time / spec.lateral_time, 0, 1)))
    sideways = d + (lane - d) * share
    places = _along(s, slower, dt)
    moved = np.diff(np.concatenate([[s], places]))
    return Plan(vehicle, places, sideways[1:], np.arctan2(np.diff(sideways), np.maximum(moved, 1e-3)), slower[1:])
