"""The proposed scenario as YAML text with comments, of at most ten lines of content."""

from dataclasses import dataclass
from pathlib import Path

import yaml

from cosim.proposals.main_road import MARGIN, EndingLane, MainRoad
from cosim.sumo.net_use import SAMPLE, NetUse

LONGEST_WARM_UP = 900.0  # [s]
SETTLED = 0.9  # share of the usual number of vehicles at which the traffic counts as settled
SHARE_OF_DEMAND = 0.25  # of the time of the demand that the warm-up takes, at most
MODELS = {"car_following": "us101_car_following", "merge": "us101_merge"}
LONGEST_HORIZON = {"car_following": 8.0, "merge": 20.0}  # [s]
SHORTEST_HORIZON = 2.0  # [s]
USUAL_GAP = 45.0  # [m], the largest gap in a group by default
GAP_TIME = {"car_following": 2.5, "merge": 1.5}  # [s]; at high speeds groups have larger gaps
FAST_DRIVER = 1.15  # times the mean speed, for the way of a fast vehicle
STUDY_SHARE = 0.5  # of the study area that a following group may drive through
ZONE_TIME = 1.2  # [s] that a vehicle is in the zone, at least; groups are looked for once a second
ZONE_MARGIN = 20.0  # [m] of the ending lane that the zone leaves free, at least


@dataclass(frozen=True)
class Choice:
    """A group rule that fits the road: merges from `lane`, or car following where it is None."""

    lane: EndingLane | None
    zone: tuple[int, int]
    horizon: float
    """Longest drive [s], whole seconds; at the speed of the traffic it ends within the study area."""
    max_gap: int

    @property
    def rule(self) -> str:
        """The name of the rule."""
        return "car_following" if self.lane is None else "merge"


def choices(road: MainRoad, use: NetUse) -> list[Choice]:
    """All group rules that fit a road, the one to be preferred first; car following is the last one."""
    return [*(_choice(road, use, lane) for lane in merging_lanes(road)), _choice(road, use, None)]


def merging_lanes(road: MainRoad) -> list[EndingLane]:
    """The lanes on which groups can merge: first those that a ramp feeds, then lanes of the road that just end."""
    usable = [lane for lane in road.ending if lane.entries or not lane.leads_off]
    return sorted(usable, key=lambda lane: (not lane.entries, lane.leads_off, lane.joins, lane.begin))


def _choice(road: MainRoad, use: NetUse, lane: EndingLane | None) -> Choice:
    speed = _speed(road, use, lane)
    rule, zone = ("car_following", (0, 0)) if lane is None else ("merge", _zone(lane, speed))
    gap = max(USUAL_GAP, GAP_TIME[rule] * speed)
    room = STUDY_SHARE * road.length if lane is None else road.length - zone[1] - gap
    time = room / (FAST_DRIVER * speed) if speed > 0 else LONGEST_HORIZON[rule]
    horizon = float(int(min(max(time, SHORTEST_HORIZON), LONGEST_HORIZON[rule])))
    return Choice(lane, zone, horizon, round(gap))


def _speed(road: MainRoad, use: NetUse, lane: EndingLane | None) -> float:
    """Mean speed [m/s] where groups are taken over: beside the lane, or on the fastest edge of the road."""
    beside = "" if lane is None else lane.lane.rpartition("_")[0]
    edges = [beside] if beside in road.edges else road.edges
    return max((use.speed.get(edge, 0.0) for edge in edges), default=0.0)


def _zone(lane: EndingLane, speed: float) -> tuple[int, int]:
    """The lane's own zone, made longer where vehicles would be through it between two looks for groups."""
    begin, end = lane.zone
    missing = max(ZONE_TIME * speed - (end - begin), 0.0)
    begin = max(begin - missing / 2, lane.begin + 1)
    end = max(end, min(begin + ZONE_TIME * speed, lane.end - ZONE_MARGIN))
    return round(begin), round(end)


def warm_up(use: NetUse, demand: float | None = None) -> float:
    """When [s] there were first nearly as many vehicles in the net as on average in the last third of the time.

    It is at most a quarter of `demand` [s], how long vehicles enter: the rest is for groups.
    """
    last = use.vehicles[-max(len(use.vehicles) // 3, 1) :]
    usual = sum(last) / max(len(last), 1)
    settled = next((k for k, count in enumerate(use.vehicles, 1) if count >= SETTLED * usual), len(use.vehicles))
    longest = LONGEST_WARM_UP if demand is None else min(LONGEST_WARM_UP, SHARE_OF_DEMAND * demand)
    return min(settled * SAMPLE, float(int(longest)))


def scenario_text(configuration: str, road: MainRoad, use: NetUse, choice: Choice, demand: float | None = None) -> str:
    """A scenario file for a choice of the group rule. `demand` [s] is how long vehicles enter, None if for ever."""
    speed = sum(use.speed.get(edge, 0.0) for edge in road.edges) / len(road.edges)
    lane, gap = choice.lane, "" if choice.max_gap == USUAL_GAP else f", max_gap: {choice.max_gap}"
    group = (
        f"{{rule: car_following{gap}}}  # vehicles one behind the other"
        if lane is None
        else f"{{rule: merge, lane: {_scalar(lane.lane)}, zone: [{choice.zone[0]}, {choice.zone[1]}]{gap},"
        f" newcomers: join}}  # the lane ends; from s = {lane.begin:g} to {lane.end:g} m"
    )
    sees, predictor = ("", "") if lane is None else (", sees: everybody", "predictor: constant_acceleration\n")
    edges, origin = ", ".join(map(_scalar, road.edges)), _scalar(road.edges[0])
    return f"""# Proposed by `cosim new {Path(configuration).name}`. Mean speed on the main road {speed:.1f} m/s.
# road: s = 0 is where `origin` begins. group: gaps and s in m. warm_up: until the number of vehicles has settled.
description: {_scalar(f"Groups in the traffic of {Path(configuration).name}")}
road: {{edges: [{edges}], origin: {origin}, length: {int(road.length - MARGIN)}}}
traffic: {{sumocfg: {_scalar(configuration)}, warm_up: {warm_up(use, demand):g}}}
group: {group}
policy: {{kind: gri, checkpoint: {MODELS[choice.rule]}{sees}}}
{predictor}horizon: {choice.horizon:g}  # [s] that a group is driven for, at most
groups_at_once: {6 if lane is None else 2}
episodes: 10
time_limit: 900  # [s] after the warm-up
"""


def _scalar(text: str) -> str:
    """A text as YAML, in quotes where it would be read as a number or anything else."""
    return yaml.safe_dump([text], default_flow_style=True, width=10_000).strip()[1:-1]
