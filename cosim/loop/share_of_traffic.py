"""A share of the traffic is driven in the trunk: from entry to exit, with lanes left to SUMO.

Every vehicle that enters is drawn once, by a hash of its id and the seed, so that a vehicle that is driven at a share
of 10 % is driven at every larger share as well. A policy commands speeds behind the next vehicle ahead
(`cosim.loop.speed_share`). SUMO's driver drives where nobody is ahead within 100 m, and where a vehicle must change
lanes within 300 m. One of SUMO's own models replaces the vehicle's model once, at its entry.

With a share of 0 nothing is commanded, and the traffic is that of the null run bit for bit.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b

import numpy as np
import torch

from cosim.loop.own_policy import PolicyFailure
from cosim.loop.pair_policy import PairPolicy
from cosim.loop.speed_share import Counts, GraphRow, SpeedShare
from cosim.loop.traffic_history import TrafficHistory
from cosim.loop.traffic_recorder import Recording, TrafficEvent, TrafficRecorder
from cosim.spec.scenario import Road
from cosim.spec.sumo_models import SumoModel
from cosim.sumo.driver_models import use_model
from cosim.sumo.merges import merges
from cosim.sumo.speed_control import SpeedControl
from cosim.traffic.driver_model_types import type_id
from cosim.traffic.running_simulation import RunningSimulation, simulation
from cosim.traffic.simulation_input import SimulationInput
from cosim.traffic.warm_up import Progress
from cosim.world.backlog import Backlog

TELL_EVERY = 100  # steps
LOOK_FOR_LANES = 1.0  # [s] between two looks whether a vehicle that keeps its lane must change it


@dataclass(frozen=True)
class SharePlan:
    """What is to drive a share of the entering vehicles: a policy, or one of SUMO's models; `reinfer` in steps."""

    share: float
    drives: PairPolicy | SumoModel
    reinfer: int = 0


@dataclass(frozen=True)
class ShareOutcome:
    """What a run with shares gave; `begin` and `end` [s] are those of the recording."""

    recording: Recording
    counts: Mapping[str, Counts]
    graphs: Mapping[str, Sequence[GraphRow]]
    failures: Mapping[str, str]
    driver_of: Mapping[str, str]
    begin: float
    end: float
    backlog: Backlog
    merge: tuple[float, float] | None
    """From where to where [m] vehicles merge into the study area; None without a merge in it."""


def drawn(vehicle: str, seed: int) -> float:
    """The vehicle's draw in [0, 1): the same whatever the shares are."""
    digest = blake2b(f"{seed}:{vehicle}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "big") / 2**64


def chosen(draw: float, plans: Mapping[str, SharePlan]) -> str:
    """The name of the plan whose part of [0, 1) has the draw; "" for none."""
    upper = 0.0
    for name, plan in plans.items():
        upper += plan.share
        if draw < upper:
            return name
    return ""


class DrivenTraffic:
    """Steps the traffic, and commands the vehicles of the shares before every step."""

    def __init__(self, running: RunningSimulation, plans: Mapping[str, SharePlan], seed: int, dt: float, bounded: bool):
        self._running, self._plans, self._seed = running, plans, seed
        self.control = SpeedControl(dt)
        policies = {name: plan for name, plan in plans.items() if isinstance(plan.drives, PairPolicy)}
        needed = max((plan.drives.history_steps for plan in policies.values()), default=1)  # type: ignore[union-attr]
        self.history = TrafficHistory(needed + 1, dt)
        self.shares = {
            name: SpeedShare(name, plan.drives, dt, plan.reinfer, bounded)  # type: ignore[arg-type]
            for name, plan in policies.items()
        }
        self.driver_of: dict[str, str] = {}
        self.events: list[TrafficEvent] = []
        self.steps, self.time = 0, 0.0
        # of each share: the lanes of its vehicles in the last step, and whether a vehicle on a lane must leave it
        self._lanes: dict[str, tuple[list[str], dict[tuple[str, str], bool | None]]] = {
            n: ([], {}) for n in self.shares
        }
        self._on_wrong_lane = {name: np.zeros(0, dtype=bool) for name in self.shares}
        self._look_every = max(round(LOOK_FOR_LANES / dt), 1)

    def step(self):
        """Command the driven vehicles, and make one step. Returns SUMO's report, who entered, and who left."""
        commanded = [(share, *found) for share in self.shares.values() if (found := self._command(share)) is not None]
        report = self._running.world.step()
        self.steps, self.time = self.steps + 1, report.time
        came, left = self.history.update(*self.control.read())
        for share, vehicles, speeds, driven in commanded:
            self._compare(share, vehicles, speeds, driven)
        for vehicle in left:
            self._forget(vehicle)
        for vehicle in came:
            self._assign(vehicle)
        return report, came, left

    def _assign(self, vehicle: str) -> None:
        """Draw who drives a vehicle that has just entered."""
        name = chosen(drawn(vehicle, self._seed), self._plans)
        if not name or not self.control.is_road_vehicle(vehicle):
            return
        self.driver_of[vehicle] = name
        drives = self._plans[name].drives
        if isinstance(drives, SumoModel):
            use_model(vehicle, type_id(name), frozenset(drives.parameters))
        elif not self.shares[name].failure:
            self.control.take(vehicle)
            self.shares[name].add(vehicle, self.control.limits(vehicle), self.control.min_gap(vehicle))

    def _forget(self, vehicle: str) -> None:
        name = self.driver_of.get(vehicle)
        if name in self.shares:
            self.shares[name].remove(vehicle)

    def _command(self, share: SpeedShare):
        """Command the vehicles of a share. Returns those that the policy drives, their speeds, and the mask of them."""
        if not share.vehicles or share.failure:
            return None
        control, column_of = self.control, self.history.column_of
        vehicles = share.vehicles
        leaders = control.leaders(vehicles)
        own = np.array([column_of[vehicle] for vehicle in vehicles])
        ahead = np.array([column_of.get(leader, -1) for leader, _ in leaders])
        gap = np.array([gap for _, gap in leaders])
        changing = self._changing(share)
        driven = (ahead >= 0) & ~changing
        try:
            speeds = share.speeds(self.steps, self.history, own, ahead, gap, driven)
        except PolicyFailure as failure:
            share.failure = str(failure)
            self.events.append(TrafficEvent(self.time, "policy_failed", (), f"{share.name}: {failure}"))
            for vehicle in vehicles:
                control.leave_to_sumo(vehicle)
            return None
        counts, number = share.counts, int(driven.sum())
        counts.commanded += number
        counts.lane_change += int(changing.sum())
        counts.nobody_ahead += len(vehicles) - number - int(changing.sum())
        for k in np.flatnonzero(~driven).tolist():
            control.leave_to_sumo(vehicles[k])
        which = np.flatnonzero(driven).tolist()
        control.command([vehicles[k] for k in which], [leaders[k][0] for k in which], speeds.tolist())
        return own[driven], speeds, driven

    def _changing(self, share: SpeedShare) -> np.ndarray:
        """Which vehicles must leave their lane soon: looked at when a vehicle is on another lane, and once a second."""
        lanes, before, known = self.control.lanes(share.vehicles), *self._lanes[share.name]
        if self.steps % self._look_every == 0:
            known = {}
        elif lanes == before:
            return self._on_wrong_lane[share.name]
        known = {
            (vehicle, lane): known.get((vehicle, lane)) for vehicle, lane in zip(share.vehicles, lanes, strict=True)
        }
        for (vehicle, lane), must in known.items():
            if must is None:
                known[vehicle, lane] = self.control.must_change_lane(vehicle)
        self._lanes[share.name] = lanes, known
        self._on_wrong_lane[share.name] = np.array([*known.values()], dtype=bool)
        return self._on_wrong_lane[share.name]

    def _compare(self, share: SpeedShare, columns: np.ndarray, speeds: np.ndarray, driven: np.ndarray) -> None:
        """Compare the speeds after the step with the commanded ones."""
        error = self.history.v[columns] - speeds
        slower = error < -1e-6
        share.counts.bounded_by_sumo += int(slower.sum())
        share.counts.largest_error = max(share.counts.largest_error, float(error.max(initial=0.0)))
        if slower.any():
            share.measured_instead(driven, slower)


@torch.inference_mode()
def drive_shares(
    inputs: SimulationInput, plans: Mapping[str, SharePlan], progress: Progress, *, bounded: bool = True
) -> ShareOutcome:
    """Run the warm-up and the time limit of a scenario with shares; vehicles are driven from the start on.

    Without `bounded` the last-moment bound is off, which is for measuring what it is good for.
    """
    scenario = inputs.scenario
    first, second = scenario.steps(scenario.traffic.warm_up), max(scenario.steps(1.0), 1)
    with simulation(inputs) as running:
        total = math.floor(inputs.end / scenario.step + 1e-6)
        lanes = {edge: running.world.net.lane_count(edge) for edge in scenario.road.edges}
        traffic = DrivenTraffic(running, plans, scenario.seed, scenario.step, bounded)
        recorder = TrafficRecorder(running.world, running.frame, scenario.road.length, lanes, traffic.driver_of)
        begin, backlog = 0.0, Backlog()
        for k in range(1, total + 1):
            report, came, left = traffic.step()
            if k == first:
                begin = report.time
                for share in traffic.shares.values():
                    share.counts = Counts()
            recorder.step(traffic.history, report, came, left)
            if k > first and (k - first) % second == 0:
                recorder.second(traffic.history)
            if k % TELL_EVERY == 0:
                progress("traffic", k, total)
                backlog = backlog.updated(running.world.waiting(), report.time)
        recorder.events += traffic.events
        return ShareOutcome(
            recording=recorder.recording(),
            counts={name: share.counts for name, share in traffic.shares.items()},
            graphs={name: share.graphs for name, share in traffic.shares.items()},
            failures={name: share.failure for name, share in traffic.shares.items() if share.failure},
            driver_of=dict(traffic.driver_of),
            begin=begin,
            end=traffic.time,
            backlog=backlog.updated(running.world.waiting(), traffic.time),
            merge=_merge(running, scenario.road),
        )


def _merge(running: RunningSimulation, road: Road) -> tuple[float, float] | None:
    """The first merge that begins in the study area."""
    found = [place for place in merges(road.edges, running.frame) if 0 <= place[0] < road.length]
    return found[0] if found else None
