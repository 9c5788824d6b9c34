"""Planning what perturbations do to a round: displaced starts, removed vehicles and planned background vehicles.

The plan is made from the last snapshot of the undisturbed history, in the same way for all policies. `intervention`
carries it out.
"""

from collections.abc import Set
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from cosim.loop.intervention import GroupChange, Intervention, NoIntervention
from cosim.loop.round_recorder import Round
from cosim.perturb.background_vehicles import PosePlan, find_cut_in_vehicle, plan_braking, plan_cut_in
from cosim.perturb.displaced_starts import (
    BRAKING,
    CAR_FOLLOWING,
    MERGE,
    Infeasible,
    VehicleStates,
    collides_despite_braking,
    displaced,
    infeasibility,
)
from cosim.perturb.traffic_demand import GRAVITY
from cosim.spec.perturbations import LeaderBraking, LowFriction, NeighbourCutIn, RemoveThird
from cosim.spec.scenario import CarFollowing, Scenario
from cosim.world.groups import Group, MergeLanes, order_of
from cosim.world.snapshot import Snapshot


def intervention_for(scenario: Scenario, now: Snapshot, this_round: Round) -> Intervention | NoIntervention:
    """What the scenario's perturbations do to a round; a `NoIntervention` where there are none."""
    return plan_intervention(scenario, now, this_round) if scenario.perturbations else NoIntervention(this_round)


def plan_intervention(scenario: Scenario, now: Snapshot, this_round: Round) -> Intervention:
    """Plan what the scenario's perturbations do to the groups of a round, and exclude infeasible starts."""
    friction = min((s.intensity for s in scenario.perturbations if isinstance(s, LowFriction)), default=np.inf)
    max_braking = min(BRAKING, friction * GRAVITY)
    changes, groups, excluded = [], [], []
    busy = set(this_round.vehicles)
    for group in this_round.groups:
        found = _change(scenario, now, this_round, group, busy, max_braking)
        if isinstance(found, GroupChange):
            busy |= {found.successor} if found.successor is not None else set()
            groups.append(group)
            changes.append(found)
        else:
            excluded.append((group, found))
    has_third = not any(isinstance(spec, RemoveThird) for spec in scenario.perturbations)
    return Intervention(
        round=replace(this_round, groups=tuple(groups), has_third_vehicle=has_third),
        excluded=tuple(excluded),
        changes=tuple(changes),
        perturbations=scenario.perturbations,
        seed=scenario.seed,
    )


def _change(
    scenario: Scenario, now: Snapshot, this_round: Round, group: Group, busy: Set[str], max_braking: float
) -> GroupChange | Infeasible:
    """What happens to one group, or why its start is infeasible; `busy` vehicles cannot be made to cut in."""
    rows = np.array([now.ids.index(vehicle) for vehicle in group.ids])
    everyone = VehicleStates(now.s, now.d, now.v, now.length, now.width)
    outside = ~np.isin(np.arange(len(now.ids)), rows)
    before, others = everyone[rows], everyone[outside]
    rule = CAR_FOLLOWING if isinstance(this_round.rule, CarFollowing) else MERGE
    after = displaced(before, scenario.perturbations, rule)
    third_removed = any(isinstance(spec, RemoveThird) for spec in scenario.perturbations)
    reason = infeasibility(
        before,
        after,
        others,
        present=np.array([True] * (this_round.size - 1) + [not third_removed]),
        span=_span(scenario.road.length, this_round.lanes, this_round.size),
        rule=rule,
        braking=max_braking,
        driven=this_round.driven_roles,
        sides=_sides(this_round.lanes),
    )
    if reason is not None:
        return reason
    names = [vehicle for vehicle, is_outside in zip(now.ids, outside, strict=True) if is_outside]
    plan, successor = None, None
    for spec in scenario.perturbations:
        match spec:
            case LeaderBraking() if spec.intensity > 0:
                s, d, v = (float(value[-1]) for value in (after.s, after.d, after.v))
                plan = plan_braking(group.leader, s, d, v, spec, this_round.dt)
            case NeighbourCutIn():
                follower = order_of(this_round.rule)[-2]
                free = np.array([vehicle not in busy for vehicle in names])
                row = find_cut_in_vehicle(after, follower, others[free], spec)
                if row is None:
                    return Infeasible.NO_NEIGHBOUR
                row = int(np.flatnonzero(free)[row])
                successor = names[row]
                own = float(others.s[row]), float(others.d[row]), float(others.v[row])
                plan = plan_cut_in(successor, own, float(after.d[-1]), float(after.v[follower]), spec, this_round.dt)
    if plan is not None and _unavoidable_contact(plan, after, everyone, now, this_round.dt, max_braking):
        return Infeasible.UNAVOIDABLE
    return GroupChange(after, (before.s != after.s) | (before.v != after.v), plan, successor)


def _span(length: float, lanes: MergeLanes | None, size: int) -> Float[np.ndarray, "N 2"]:
    """The range of s [m] in which each vehicle can start; for a merging vehicle it is the lane that ends."""
    span = np.array([[0.0, length]] * size)
    if lanes is not None:
        span[0] = lanes.source.begin, lanes.source.end
    return span


def _sides(lanes: MergeLanes | None) -> tuple[float, float] | None:
    """The range of d [m] from the lane that ends to the border on the other side; None in car following."""
    if lanes is None:
        return None
    half = 0.5 * lanes.target.width
    if lanes.side < 0:  # a lane on the left ends: no road beyond it; to the right, as far as the target lane
        return lanes.target.centre - half, lanes.source.centre + half
    return lanes.source.centre - half, half  # d = 0 is the centre of the leftmost lane


def _unavoidable_contact(
    plan: PosePlan, group: VehicleStates, everyone: VehicleStates, now: Snapshot, dt: float, max_braking: float
) -> bool:
    """Whether a follower in the plan's lane runs into the planned vehicle even if it brakes from the start."""
    row = now.ids.index(plan.vehicle)
    length, width = everyone.length[row], everyone.width[row]
    speeds = np.concatenate([[everyone.v[row]], plan.v])
    for role in range(len(group.s) - 1):
        in_lane = abs(group.d[role] - plan.d[-1]) < 0.5 * (group.width[role] + width)
        gap = float(everyone.s[row] - length - group.s[role])
        if in_lane and gap > 0 and collides_despite_braking(gap, float(group.v[role]), speeds, dt, max_braking):
            return True
    return False
