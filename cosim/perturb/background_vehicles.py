"""Plans of background vehicles under a perturbation: one pose per step, after which SUMO drives the vehicle again."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from cosim.perturb.displaced_starts import VehicleStates
from cosim.spec.perturbations import LeaderBraking, NeighbourCutIn

Steps = Float[np.ndarray, " T"]
LANE_WIDTH = 3.66  # [m], twelve feet


@dataclass(frozen=True)
class PosePlan:
    """A vehicle's poses after each step: front bumper (s, d) [m], heading relative to the road [rad], speed [m/s]."""

    vehicle: str
    s: Steps
    d: Steps
    heading: Steps
    v: Steps


def _positions(s: float, v: Float[np.ndarray, " U"], dt: float) -> Steps:
    """Positions [m] after each step at the speeds v[0] (now), v[1], …; the acceleration is constant within a step."""
    return s + np.cumsum(0.5 * dt * (v[1:] + v[:-1]))


def plan_braking(vehicle: str, s: float, d: float, v: float, spec: LeaderBraking, dt: float) -> PosePlan:
    """Brake at `spec.intensity` [m/s²] for `spec.duration` [s], or until the vehicle stands."""
    steps = round(spec.duration / dt)
    speed = np.maximum(v - spec.intensity * dt * np.arange(steps + 1), 0.0)
    return PosePlan(vehicle, _positions(s, speed, dt), np.full(steps, d), np.zeros(steps), speed[1:])


def find_cut_in_vehicle(group: VehicleStates, follower: int, others: VehicleStates, spec: NeighbourCutIn) -> int | None:
    """Row of the vehicle that is to cut in between the leader and its follower; None where no vehicle can.

    It is in a lane beside that of the leader and, along the road, clear of both vehicles by `spec.clearance` [m]. Of
    several the one nearest to the follower is taken.
    """
    low, high = group.s[follower] + spec.clearance, group.s[-1] - group.length[-1] - spec.clearance
    across = np.abs(others.d - group.d[-1])
    beside = (across > 0.5 * LANE_WIDTH) & (across < 1.5 * LANE_WIDTH)
    fits = np.flatnonzero(beside & (others.s - others.length > low) & (others.s < high))
    return int(fits[np.argmin(others.s[fits])]) if len(fits) else None


def plan_cut_in(
    vehicle: str, state: tuple[float, float, float], lane: float, v_follower: float, spec: NeighbourCutIn, dt: float
) -> PosePlan:
    """Change from (s, d, v) to the lateral position `lane` [m] and brake to `v_follower` [m/s] − `spec.intensity`.

    The lateral position follows a half cosine in `spec.lateral_time` [s]; the heading is the direction of travel.
    """
    s, d, v = state
    steps = round(spec.duration / dt)
    time = dt * np.arange(steps + 1)
    wanted = max(v_follower - spec.intensity, 0.0)
    speed = np.maximum(v - spec.deceleration * time, min(wanted, v))
    share = 0.5 * (1 - np.cos(np.pi * np.clip(time / spec.lateral_time, 0, 1)))
    lateral = d + (lane - d) * share
    along = _positions(s, speed, dt)
    moved = np.diff(np.concatenate([[s], along]))
    heading = np.arctan2(np.diff(lateral), np.maximum(moved, 1e-3))
    return PosePlan(vehicle, along, lateral[1:], heading, speed[1:])
