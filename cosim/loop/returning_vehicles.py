"""Carries out the gradual hand-back in SUMO: vehicles that return to SUMO's drivers, and vehicles that must stop.

After a contact, at the end of a lane and beside the road a vehicle brakes to a standstill and stays there. SUMO's own
driver would stop it within a step or two, or remove it. All other vehicles return to SUMO's drivers.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cosim.loop import gradual_hand_back as plan
from cosim.loop import shadow_vehicles
from cosim.loop.gradual_hand_back import Drift, Stop
from cosim.measures.following import CLEARANCE, TOUCHING, Ahead, Headway, found, required_braking
from cosim.sumo import Sumo
from cosim.world.groups import MergeLanes
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Snapshot

LOOK_AHEAD = 100.0  # [m] in another lane
CENTRED = 0.3  # [m] from the centre of a lane, from which SUMO may change it: it keeps that offset in the new lane


@dataclass(frozen=True)
class Return:
    """A vehicle on its way back to SUMO's driver.

    `headway` is what it wants now, `own` what its driver wants in the end, `acceleration` [m/s²] is the driver's
    largest one, `a` [m/s²] the policy's last one. `checked` says whether SUMO's safe speed counts. `leader` is the
    vehicle ahead that the headway was found for. `must_leave` says whether its lane does not lead on. `time` [s] counts
    from the hand-back.
    """

    own: Headway
    headway: Headway
    acceleration: float
    drift: Drift
    a: float
    checked: bool
    must_leave: bool = False
    leader: str = ""
    time: float = 0.0


@dataclass(frozen=True)
class ReturningVehicles:
    """The vehicles of a round that were handed back, by id; `lanes` are those of a merge, `dt` [s] is the step."""

    dt: float
    lanes: MergeLanes | None = None
    _returns: dict[str, Return] = field(default_factory=dict)
    _stops: dict[str, Stop] = field(default_factory=dict)

    @property
    def are_there(self) -> bool:
        """Whether there are any."""
        return bool(self._returns or self._stops)

    def hand_back(self, world: Sumo, vehicle: str, a: float, lateral_speed: float, *, checked: bool) -> None:
        """Begin to hand a driven vehicle back; its last acceleration [m/s²] and lateral speed [m/s] go on at first.

        `checked` should be off near a contact: SUMO does not know which of two vehicles is ahead that drove through
        each other, and brakes for one that is behind.
        """
        drivers = world.drivers
        own, acceleration = Headway(*drivers.headway(vehicle)), drivers.parameters(vehicle).acceleration
        drift = Drift(world.net.side * drivers.lane_offset(vehicle), lateral_speed)
        a = min(max(a, -plan.HARDEST_BRAKING), plan.HARDEST_BRAKING)
        must_leave = drivers.way_in_lane(vehicle) < math.inf
        self._returns[vehicle] = Return(own, own, acceleration, drift, a, checked, must_leave)
        world.begin_release(vehicle)

    def stop(self, world: Sumo, vehicle: str, state: Stop) -> None:
        """Begin to stop a vehicle."""
        self._returns.pop(vehicle, None)
        self._stops[vehicle] = state
        world.take(vehicle)

    def command(self, world: Sumo, road: RoadFrame, now: Snapshot) -> None:
        """Command all these vehicles before a step."""
        for vehicles in (self._returns, self._stops):
            for vehicle in [vehicle for vehicle in vehicles if vehicle not in now.row_of]:
                del vehicles[vehicle]
                world.remove_shadow(vehicle)
        returns = [*self._returns.items()]
        ways = _in_way_of_drifts(now, [now.row_of[vehicle] for vehicle, _ in returns], [of for _, of in returns])
        for (vehicle, state), in_way in zip(returns, ways, strict=True):
            self._guide(world, road, vehicle, state, now, in_way)
        for vehicle, stop in self._stops.items():
            self._stops[vehicle] = stop = stop.after(self.dt)
            lane = self._show(world, road, vehicle, (stop.s, stop.d, stop.heading, stop.v), now)
            xy, along = road.to_world(np.array([stop.s]), np.array([stop.d]))
            world.command(
                vehicle, float(xy[0, 0]), float(xy[0, 1]), float(along[0]) + road.side * stop.heading, stop.v, lane
            )

    def _guide(
        self, world: Sumo, road: RoadFrame, vehicle: str, state: Return, now: Snapshot, in_way: int | None
    ) -> None:
        """Command one returning vehicle, or release it where SUMO's driver has its own headway again.

        `in_way` is the row of the vehicle of `_in_way_of_drifts`.
        """
        row, dt, drivers = now.row_of[vehicle], self.dt, world.drivers
        s, d, v = (float(of[row]) for of in (now.s, now.d, now.v))
        headway, time = plan.relaxed(state.headway, state.own, dt), state.time + dt
        leader, gap = drivers.leader(vehicle) or ("", math.inf)
        ahead = Ahead(gap, *drivers.motion(leader)) if leader else None
        if ahead is not None and leader != state.leader:
            headway = found(headway, v, ahead)
        if time > max(plan.DURATION, state.drift.duration) and headway == state.own:
            del self._returns[vehicle]
            world.release(vehicle)
            return
        limit, required = drivers.allowed_speed(vehicle), required_braking(v, ahead)
        wanted = plan.wanted_acceleration(v, limit, state.acceleration, headway, ahead)
        if state.must_leave:  # SUMO's driver would brake for the end of its lane late and at once
            end = Ahead(drivers.way_in_lane(vehicle), 0.0, 0.0)
            for_the_end = plan.wanted_acceleration(v, limit, state.acceleration, Headway(0.0, CLEARANCE), end)
            wanted, required = min(wanted, for_the_end), max(required, required_braking(v, end))
        beside = None
        if in_way is not None and now.ids[in_way] != leader:  # SUMO's driver does not see it
            gap_beside = float(now.s[in_way] - now.length[in_way] - now.s[row])
            beside = Ahead(gap_beside, float(now.v[in_way]), float(now.a[in_way]))
        if beside is not None and beside.gap > TOUCHING:
            for_it = plan.wanted_acceleration(v, limit, state.acceleration, found(headway, v, beside), beside)
            wanted, required = min(wanted, for_it), max(required, required_braking(v, beside))
        elif beside is not None:
            wanted = min(wanted, -plan.FIRM)
        a = plan.next_acceleration(state.a if state.time == 0 else float(now.a[row]), wanted, required, dt)
        speed, lateral = max(v + a * dt, 0.0), state.drift.at(time)
        world.set_headway(vehicle, headway.time, headway.gap)
        # SUMO's safe speed is for what the plan does not know, such as the end of a lane. Where the plan is faster than
        # SUMO's driver would be behind the vehicle ahead, or at the speed limit, it is so on purpose.
        known = limit
        if ahead is not None:
            net_gap, braking = gap - headway.gap, drivers.braking(leader)
            known = min(limit, drivers.follow_speed(vehicle, v, net_gap, ahead.v, braking))
        world.guide(vehicle, speed, lateral, safely=state.checked and speed <= known)
        if state.must_leave and abs(lateral) < CENTRED:
            world.allow_lane_changes(vehicle)
        aside = lateral - state.drift.at(state.time)
        self._show(world, road, vehicle, (s + speed * dt, d + aside, 0.0, speed), now)
        self._returns[vehicle] = replace(state, headway=headway, leader=leader, time=time)

    def _show(
        self, world: Sumo, road: RoadFrame, vehicle: str, pose: tuple[float, float, float, float], now: Snapshot
    ) -> str:
        """Make a vehicle between two lanes visible in both; returns the lane that SUMO is to assign it to."""
        if self.lanes is None:
            return ""
        return shadow_vehicles.place(world, road, vehicle, pose, self.lanes, now, self.dt, announcing=False)


def _in_way_of_drifts(now: Snapshot, rows: Sequence[int], returns: Sequence[Return]) -> list[int | None]:
    """The row of the nearest vehicle ahead in another lane into which each returning vehicle reaches from now on.

    `rows` are those of the returning vehicles. One that is beside it counts as ahead where its front is.
    """
    if not rows:
        return []
    rightmost, leftmost = np.array([of.drift.range_from(of.time) for of in returns]).T[:, :, None]
    own = now.d[rows, None] - np.array([of.drift.at(of.time) for of in returns])[:, None]  # of the centre of its lane
    apart = 0.5 * (now.width + now.width[rows, None])
    reached = (now.d > own + rightmost - apart) & (now.d < own + leftmost + apart)
    reached &= np.abs(now.d - own) > 0.5 * now.width[rows, None]  # elsewhere
    reached &= now.s > now.s[rows, None]
    if not reached.any():
        return [None] * len(rows)
    gap = now.s - now.length - now.s[rows, None]
    gap[~reached | (gap >= LOOK_AHEAD)] = np.inf
    return [row if least < np.inf else None for row, least in zip(gap.argmin(1).tolist(), gap.min(1), strict=True)]


def stop_of(now: Snapshot, road: RoadFrame, vehicle: str, a: float, braking: float) -> Stop:
    """A vehicle as it is now, at the acceleration `a` [m/s²], about to brake with `braking` [m/s²]."""
    row = now.row_of[vehicle]
    s, d, heading, v = (float(of[row]) for of in (now.s, now.d, now.heading, now.v))
    jerk = plan.EMERGENCY_JERK if braking > plan.EMERGENCY else plan.FIRM_JERK
    turned = road.side * (heading - float(road.heading_at(now.s[[row]])[0]))
    return Stop(s, d, math.remainder(turned, 2 * math.pi), v, a, braking, jerk)
