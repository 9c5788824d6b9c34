"""Clips: candidates cut out of the buffer, and what SUMO reports about them in the form that labels are made from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from cosim.measures.relation_labels import NO_VEHICLE, DriverRecords
from cosim.scenes.candidates import Window, rows_at_every_step
from cosim.scenes.driver_models import model_of, with_imprecision
from cosim.scenes.scene_rules import Kind
from cosim.scenes.trajectory_buffer import COLUMN, BufferedStep, TrajectoryBuffer
from cosim.world.snapshot import DriverParameters

FAR = 10_000.0  # [m] behind a leader, where it has no effect


@dataclass(frozen=True)
class Clip:
    """A candidate that was present throughout; it has M = T + 1 steps, one more than the scene."""

    window: Window
    time: float
    """Simulation time of step 0 [s]."""
    drivers: tuple[DriverParameters, ...]
    values: Float[np.ndarray, "N M F"]
    """Per vehicle and step the columns of the buffer (`trajectory_buffer.COLUMNS`)."""
    speed_behind_leader: Float[np.ndarray, "N M"]
    """Speed [m/s] that the car-following model allows behind the leader; inf where no label can depend on it."""
    speed_behind_target: Float[np.ndarray, "N M"]
    """The same behind the target of an urgent lane change, if the target is one of the vehicles; else inf."""
    speed_far_behind: Float[np.ndarray, "N M"]
    """The same `FAR` behind a leader of the same speed: the free speed of models that approach it gradually."""

    @property
    def speeds(self) -> Float[np.ndarray, "N M"]:
        """[m/s]"""
        return self.values[..., COLUMN["v"]]

    @property
    def kind(self) -> Kind:
        return self.window.kind


def cut_clip(window: Window, buffer: TrajectoryBuffer, scene_steps: int) -> Clip | None:
    """The clip of a window of `scene_steps` + 1 steps that ends now; None if a vehicle was missing in one of them."""
    steps = [step for step in buffer.steps if step.index >= window.begin]
    assert len(steps) == scene_steps + 1, f"got {len(steps)} steps, wanted {scene_steps + 1}"
    rows = rows_at_every_step(steps, window.vehicles)
    if rows is None:
        return None
    buffer.await_interventions()
    values = np.stack([step.values[rows[:, t]] for t, step in enumerate(steps)], 1)
    limits = np.array([step.limits for step in steps])
    values[..., COLUMN["limit"]] = limits[np.arange(len(steps)), values[..., COLUMN["lane"]].astype(int)]
    if buffer.stride == 1:
        values[:, :-1, COLUMN["v_next"]] = values[:, 1:, COLUMN["v"]]
    ids = [steps[0].ids[row] for row in rows[:, 0]]
    asked = [buffer.world.drivers.parameters(vehicle) for vehicle in ids]
    drivers = tuple(with_imprecision(driver, model_of(driver, buffer.models)) for driver in asked)
    leader, requester, target = (values[..., COLUMN[name]].astype(int) for name in ("leader", "requester", "target"))
    leader_inside, requester_inside, target_inside = (
        (number[..., None] == window.vehicles).any(-1) for number in (leader, requester, target)
    )
    # A label can depend on the leader's effect if the leader is one of these vehicles, or if it explains a lower speed.
    relevant = leader_inside | ((requester_inside | target_inside) & (leader != NO_VEHICLE))
    behind_leader = _allowed_speeds(buffer, steps, ids, values, "gap", np.where(relevant, leader, NO_VEHICLE))
    behind_target = _allowed_speeds(
        buffer, steps, ids, values, "target_gap", np.where(target_inside, target, NO_VEHICLE)
    )
    far_behind = np.full(leader.shape, np.inf)
    for j, t in np.argwhere(np.isfinite(behind_leader) | np.isfinite(behind_target)).tolist():
        v = float(values[j, t, COLUMN["v"]])
        braking = float(values[j, t, COLUMN["braking"]])
        far_behind[j, t] = buffer.world.drivers.follow_speed(ids[j], v, FAR, v, braking)
    return Clip(window, steps[0].time, drivers, values, behind_leader, behind_target, far_behind)


def _allowed_speeds(
    buffer: TrajectoryBuffer,
    steps: Sequence[BufferedStep],
    ids: list[str],
    values: np.ndarray,
    gap_column: str,
    ahead: Int[np.ndarray, "N M"],
) -> Float[np.ndarray, "N M"]:
    """Speeds [m/s] that SUMO's car-following models allow behind the vehicles `ahead`; inf where there is none."""
    allowed = np.full(ahead.shape, np.inf)
    for j, t in np.argwhere(ahead != NO_VEHICLE).tolist():
        step = steps[t]
        row = step.row_of.get(int(ahead[j, t]))
        if row is None:  # beyond the road section: it may have slowed the vehicle to any speed
            allowed[j, t] = 0.0
            continue
        v, gap = values[j, t, [COLUMN["v"], COLUMN[gap_column]]].tolist()
        v_ahead, braking = step.values[row, [COLUMN["v"], COLUMN["braking"]]].tolist()
        allowed[j, t] = buffer.world.drivers.follow_speed(ids[j], v, gap, v_ahead, braking)
    return allowed


def driver_records_of(clips: Sequence[Clip], dt: float, stride: int) -> DriverRecords:
    """What SUMO reports about the vehicles of S clips of one kind, for `cosim.measures.relation_labels`."""
    values = np.stack([clip.values[:, :-1] for clip in clips])
    v, limit = values[..., COLUMN["v"]], values[..., COLUMN["limit"]]
    leader, requester, target, new_follower = (
        values[..., COLUMN[name]].astype(int) for name in ("leader", "requester", "target", "new_follower")
    )
    far_behind = np.stack([clip.speed_far_behind for clip in clips])
    factor, top, acceleration, imperfection = (
        np.array([[getattr(driver, name) for driver in clip.drivers] for clip in clips])[..., None]
        for name in ("speed_factor", "max_speed", "acceleration", "imperfection")
    )
    return DriverRecords(
        vehicle=np.array([clip.window.vehicles for clip in clips]),
        v=v,
        v_next=values[..., COLUMN["v_next"]],
        free_speed=np.minimum.reduce(
            [v + acceleration * dt, limit * factor, np.broadcast_to(top, v.shape), far_behind[..., :-1]]
        ),
        speed_behind_leader=np.stack([clip.speed_behind_leader[:, :-1] for clip in clips]),
        imperfection=np.broadcast_to(imperfection * acceleration, v.shape),
        speed_behind_target=np.stack([clip.speed_behind_target[:, :-1] for clip in clips]),
        leader=leader,
        requester=requester,
        target=target,
        cooperative_change=values[..., COLUMN["cooperative_change"]] > 0,
        new_follower=new_follower,
        new_follower_margin=values[..., COLUMN["new_follower_margin"]],
        dt=dt,
        stride=stride,
    )


def intervention_effects(clips: Sequence[Clip]) -> tuple[np.ndarray, np.ndarray]:
    """[S, N, T] Accelerations [m/s²] that the vehicles owe to their leader, and to requests to make room (negative)."""
    values = np.stack([clip.values[:, :-1] for clip in clips])
    return values[..., COLUMN["effect_of_leader"]], values[..., COLUMN["effect_of_requests"]]


def decisions_known(clips: Sequence[Clip]) -> Bool[np.ndarray, " S"]:
    """Whether the last decision of every vehicle is known at all steps of each clip."""
    return np.array([bool(clip.values[:, :-1, COLUMN["decision_known"]].all()) for clip in clips])
