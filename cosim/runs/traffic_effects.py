"""Effects of perturbations of the traffic: what the study area is like with and without them, for the same seed."""

import hashlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace

from cosim.perturb.effects import Effect
from cosim.perturb.traffic_demand import GRAVITY, driver_shares, perturbed_traffic
from cosim.runs.traffic_survey import Survey, survey
from cosim.spec.input_files import find_net, sha256
from cosim.spec.perturbations import (
    CHANGES_DEMAND,
    AggressiveDrivers,
    DenserTraffic,
    LowFriction,
    MoreTrucks,
    Perturbation,
)
from cosim.spec.scenario import Replay, Scenario
from cosim.traffic.scratch_files import scratch_files
from cosim.traffic.warm_up import Progress
from gri.storage.verification import is_intact, read_sealed, write_sealed

ROAD_IS_FULL = 20  # more vehicles than without the perturbation that wait outside the net


@dataclass(frozen=True)
class TrafficState:
    """The traffic in the study area in the first demand interval after the warm-up, by Edie's definitions.

    `flow` [veh/h], `density` [veh/km, all lanes together], `speed` [m/s] = flow/density, `waiting` vehicles outside the
    net at the end, `hardest_braking` [m/s²] of any vehicle, `shares` of the vehicle classes.
    """

    flow: float
    density: float
    speed: float
    waiting: int
    hardest_braking: float
    shares: dict[str, float]


def traffic_state(scenario: Scenario, found: Survey) -> TrafficState:
    """The state of surveyed traffic: flow = Σv/length and density = n/length, averaged over the seconds."""
    samples = found.samples
    seconds, kilometres = max(samples["time"].nunique(), 1), scenario.road.length / 1000
    density = len(samples) / seconds / kilometres
    flow = 3.6 * float(samples["v"].sum()) / seconds / kilometres
    kinds = samples.drop_duplicates("vehicle")["kind"].value_counts(normalize=True)
    return TrafficState(
        flow=flow,
        density=density,
        speed=flow / density / 3.6 if density else np.nan,
        waiting=found.waiting,
        hardest_braking=found.hardest_braking,
        shares={str(kind): float(share) for kind, share in kinds.items()},
    )


def survey_traffic(
    scenario: Scenario, tell: Progress, cache: Path | None = None, scratch: Path | None = None
) -> TrafficState:
    """Simulate the warm-up and one demand interval of the scenario's traffic, perturbed as the scenario says.

    With the folder `cache`, the result is kept there and read again by the next call for the same traffic. SUMO's files
    are in the folder `scratch` meanwhile.
    """
    net = find_net(scenario.net)
    duration = min(scenario.traffic.interval, scenario.time_limit)
    same = (perturbed_traffic(scenario).traffic, scenario.road, scenario.seed, scenario.step, duration, sha256(net))
    file = None
    if cache is not None:
        file = cache / f"traffic-{hashlib.sha256(msgspec.json.encode(same)).hexdigest()[:12]}.json"
        if is_intact(file, lambda _: None):  # a damaged one is set aside and made again
            return msgspec.convert(read_sealed(file, ""), TrafficState)
    with scratch_files(net, scratch) as files:
        state = traffic_state(scenario, survey(scenario, files, duration, tell))
    if file is not None:
        write_sealed(file, asdict(state))
    return state


def traffic_effects(
    scenario: Scenario, tell: Progress, cache: Path | None = None, scratch: Path | None = None
) -> list[Effect]:
    """The effects of the scenario's perturbations of the traffic; two simulations, or none where there are no such.

    Raises `InputError` where SUMO refuses the traffic.
    """
    specs = [spec for spec in scenario.perturbations if isinstance(spec, CHANGES_DEMAND)]
    if not specs or isinstance(scenario.background, Replay):
        return []
    before = survey_traffic(replace(scenario, perturbations=()), tell, cache, scratch)
    after = survey_traffic(replace(scenario, perturbations=tuple(specs)), tell, cache, scratch)
    return compared_traffic(scenario, before, after)


def compared_traffic(scenario: Scenario, before: TrafficState, after: TrafficState) -> list[Effect]:
    """The effects of the scenario's perturbations of the traffic, from its states without and with them."""
    shares = driver_shares(perturbed_traffic(scenario).traffic)
    specs = [spec for spec in scenario.perturbations if isinstance(spec, CHANGES_DEMAND)]
    return [effect for spec in specs for effect in _compared(spec, before, after, shares)]


def _compared(
    spec: Perturbation, before: TrafficState, after: TrafficState, shares: dict[str, float]
) -> Iterator[Effect]:
    """Stated are the density of denser traffic, the speed and shares of other drivers, and braking at low friction."""
    density = spec.intensity * before.density if isinstance(spec, DenserTraffic) else np.nan
    speed = before.speed if isinstance(spec, MoreTrucks | AggressiveDrivers) else np.nan
    full = after.waiting - before.waiting > ROAD_IS_FULL
    remark = f"the road is full: {after.waiting} vehicles wait outside" if full else ""
    yield Effect(spec.kind, spec.intensity, "density", "veh/km", density, after.density, before.density, remark)
    yield Effect(spec.kind, spec.intensity, "flow", "veh/h", np.nan, after.flow, before.flow)
    yield Effect(spec.kind, spec.intensity, "mean speed", "m/s", speed, after.speed, before.speed)
    waiting = (np.nan, float(after.waiting), float(before.waiting))
    yield Effect(spec.kind, spec.intensity, "vehicles waiting outside", "", *waiting)
    if isinstance(spec, LowFriction):
        braking = (-spec.intensity * GRAVITY, after.hardest_braking, before.hardest_braking)
        yield Effect(spec.kind, spec.intensity, "hardest braking of SUMO's drivers", "m/s²", *braking)
    chosen = isinstance(spec, MoreTrucks | AggressiveDrivers)
    for kind, share in shares.items():
        found = (share if chosen else np.nan, after.shares.get(kind, 0.0), before.shares.get(kind, 0.0))
        yield Effect(spec.kind, spec.intensity, f"share of {kind}", "", *found)
