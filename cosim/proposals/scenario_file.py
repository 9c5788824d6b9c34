"""The proposed scenario as YAML text with comments."""

from pathlib import Path

import yaml

from cosim.proposals.main_road import MARGIN, EndingLane, MainRoad
from cosim.sumo.net_use import SAMPLE, NetUse

LONGEST_WARM_UP = 900.0  # [s]
SETTLED = 0.9  # share of the usual number of vehicles at which the traffic counts as settled
MODELS = {"car_following": "us101_car_following", "merge": "us101_merge"}
HORIZONS = {"car_following": 8.0, "merge": 20.0}  # [s]


def warm_up(use: NetUse) -> float:
    """When [s] there were first nearly as many vehicles in the net as on average in the last third of the time."""
    last = use.vehicles[-max(len(use.vehicles) // 3, 1) :]
    usual = sum(last) / max(len(last), 1)
    settled = next((k for k, count in enumerate(use.vehicles, 1) if count >= SETTLED * usual), len(use.vehicles))
    return min(settled * SAMPLE, LONGEST_WARM_UP)


def merging_lane(road: MainRoad) -> EndingLane | None:
    """The ending lane on which groups can merge: fed from outside, best one that only ends."""
    usable = [lane for lane in road.ending if lane.entries]
    return min(usable, key=lambda lane: (lane.leads_off, lane.joins, lane.begin), default=None)


def scenario_text(configuration: str, road: MainRoad, use: NetUse, lane: EndingLane | None, model: str = "") -> str:
    """A scenario file: merges from `lane`, car following where it is None. `model` replaces the usual checkpoint."""
    rule = "car_following" if lane is None else "merge"
    speed = sum(use.speed.get(edge, 0.0) for edge in road.edges) / len(road.edges)
    group = (
        f"  rule: car_following\n  max_gap: {max(45, round(2.5 * speed))}  # [m]"
        if lane is None
        else f"  rule: merge\n  lane: {_scalar(lane.lane)}  # it ends; from s = {lane.begin:g} to {lane.end:g} m\n"
        f"  zone: [{lane.zone[0]}, {lane.zone[1]}]  # s [m] at which a group is taken over"
    )
    return f"""# Proposed by `cosim new {Path(configuration).name}`. Mean speed on the main road {speed:.1f} m/s.
description: Groups in the traffic of {Path(configuration).name}
road:  # the main road; s = 0 is where `origin` begins
  edges: [{", ".join(map(_scalar, road.edges))}]
  origin: {_scalar(road.edges[0])}
  length: {int(road.length - MARGIN)}  # [m]
traffic:
  sumocfg: {_scalar(configuration)}
  warm_up: {warm_up(use):g}  # [s] until the number of vehicles has settled
group:
{group}
policy: {{kind: gri, checkpoint: {_scalar(model or MODELS[rule])}}}
horizon: {HORIZONS[rule]}  # [s] that a group is driven for, at most
groups_at_once: {6 if lane is None else 2}
episodes: 10
time_limit: 900  # [s] after the warm-up
"""


def _scalar(text: str) -> str:
    """A text as YAML, in quotes where it would be read as a number or anything else."""
    return yaml.safe_dump(text, default_flow_style=True, width=10_000).removesuffix("\n").removesuffix("\n...")
