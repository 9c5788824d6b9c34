"""What the perturbations of a round reached, measured from the recorded drive."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from cosim.loop.driving import RoundStart, drive
from cosim.loop.intervention import GroupChange, Intervention
from cosim.loop.take_over_and_hand_back import PolicyControl
from cosim.perturb.displaced_starts import CAR_FOLLOWING, MERGE
from cosim.perturb.effects import Effect
from cosim.spec.perturbations import (
    HeadwayMetres,
    HeadwayRatio,
    LeaderBraking,
    NeighbourCutIn,
    Perturbation,
    RemoveThird,
    SpeedOffset,
)
from cosim.spec.scenario import CarFollowing
from cosim.sumo import Sumo
from cosim.world.episode import COLUMNS, Episode
from cosim.world.groups import order_of
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Snapshot

_S, _V, _A = (COLUMNS.index(name) for name in ("s", "v", "a"))


def drive_and_measure(world: Sumo, road: RoadFrame, start: RoundStart) -> tuple[list[Episode], list[Effect]]:
    """Drive a round (`cosim.loop.driving.drive`) and measure the effects of its perturbations on every group."""
    episodes = drive(world, road, start)
    return episodes, [effect for of_group in effects_of(start, episodes) for effect in of_group]


def effects_of(start: RoundStart, episodes: Sequence[Episode]) -> list[list[Effect]]:
    """The effects of the perturbations on each group of a round that has been driven."""
    intervention, control = start.intervention, start.control
    if not isinstance(intervention, Intervention):
        return [[] for _ in episodes]
    found = []
    for g, (episode, change) in enumerate(zip(episodes, intervention.changes, strict=True)):
        effects = [e for spec in intervention.perturbations for e in _effects(spec, intervention, change, episode)]
        found.append(effects + (control.runner.effects(g, episode.end) if isinstance(control, PolicyControl) else []))
    return found


def _effects(spec: Perturbation, plan: Intervention, change: GroupChange, episode: Episode) -> Iterator[Effect]:
    """The effects of one perturbation of the start or of a background vehicle; none for other kinds."""
    one_lane = isinstance(plan.round.rule, CarFollowing)
    rule = CAR_FOLLOWING if one_lane else MERGE
    take_over = int(np.searchsorted(episode.time, episode.group.time + 1e-6)) - 1
    before, after = episode.state[take_over], _start(episode, take_over, change, one_lane)
    match spec:
        case HeadwayRatio():
            yield _shortening(spec, before, after, rule.pair)
        case HeadwayMetres():
            moved = float((after - before)[rule.pair[0], _S])
            yield Effect(spec.kind, spec.intensity, "displacement of the follower", "m", spec.intensity, moved, 0.0)
        case SpeedOffset():
            stated = max(spec.intensity, -float(before[0, _V]))
            faster = float((after - before)[0, _V])
            yield Effect(spec.kind, spec.intensity, "change of the speed of vehicle 0", "m/s", stated, faster, 0.0)
        case RemoveThird():
            yield _shortening(spec, before, after, rule.pair_without_third)
            present = [episode.group.ids[2] in now.ids for now in plan.snapshots]
            quantity = "share of steps with vehicle 2"
            yield Effect(spec.kind, spec.intensity, quantity, "", 0.0, float(np.mean(present)), 1.0)
        case LeaderBraking():
            yield from _braking(spec, plan.round.size - 1, episode.feature("v")[take_over:, -1], plan.round.dt)
        case NeighbourCutIn():
            follower = float(change.start.v[order_of(plan.round.rule)[-2]])
            yield from _cut_in(spec, change, follower, episode.group.time, plan.snapshots)
        case _:
            return


def _start(episode: Episode, take_over: int, change: GroupChange, one_lane: bool) -> Float[np.ndarray, "N C"]:
    """The states from which the group started, from the states one step later.

    Of a vehicle that a policy drives this inverts a step of the dynamics: v' = v + a·Δt and, in one lane,
    x' = x + v·Δt + a·Δt²/2, in a merge x' = x + v·Δt. Any other displaced vehicle keeps its speed in the first step.
    """
    state, later = episode.state[take_over].copy(), episode.state[take_over + 1]
    dt = float(episode.time[take_over + 1] - episode.time[take_over])
    for role in np.flatnonzero(change.moved):
        a = state[role, _A] if episode.driven[take_over + 1, role] else 0.0
        v = later[role, _V] - a * dt
        state[role, _V] = v
        state[role, _S] = later[role, _S] - v * dt - (0.5 * a * dt**2 if one_lane else 0.0)
    return state


def _shortening(
    spec: HeadwayRatio | RemoveThird,
    before: Float[np.ndarray, "N C"],
    after: Float[np.ndarray, "N C"],
    pair: tuple[int, int],
) -> Effect:
    follower, leader = pair
    headways = [float(state[leader, _S] - state[follower, _S]) for state in (before, after)]
    quantity = "share by which the headway is shorter"
    return Effect(spec.kind, spec.intensity, quantity, "", spec.intensity, 1 - headways[1] / headways[0], 0.0)


def _braking(spec: LeaderBraking, leader: int, v: Float[np.ndarray, " T"], dt: float) -> Iterator[Effect]:
    """Mean braking until the vehicle stands, or to the end of the time for which it brakes."""
    speeds = v[: round(spec.duration / dt) + 1]
    steps = int((speeds[1:] > 1e-6).sum())
    if steps:
        braking = float(speeds[0] - speeds[steps]) / (steps * dt)
        yield Effect(spec.kind, spec.intensity, f"mean braking of vehicle {leader}", "m/s²", spec.intensity, braking)


def _cut_in(
    spec: NeighbourCutIn, change: GroupChange, v_follower: float, take_over: float, snapshots: Sequence[Snapshot]
) -> Iterator[Effect]:
    """Where the vehicle is across the road after the lane change, and its speed at the end of its plan."""
    assert change.successor is not None, "a group without a neighbour is infeasible"
    for quantity, unit, after, stated in (
        ("offset after the lane change", "m", spec.lateral_time, 0.0),
        ("speed below the follower's", "m/s", spec.duration, spec.intensity),
    ):
        now = next((now for now in snapshots if abs(now.time - take_over - after) < 1e-6), None)
        if now is None or change.successor not in now.ids:
            continue
        row = now.ids.index(change.successor)
        offset = abs(float(now.d[row]) - float(change.start.d[-1]))
        value = offset if unit == "m" else v_follower - float(now.v[row])
        yield Effect(spec.kind, spec.intensity, quantity, unit, stated, value)
