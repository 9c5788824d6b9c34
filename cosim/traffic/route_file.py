"""SUMO's route file, file of speed signs and arguments as text, made from a traffic description by pure functions."""

from collections.abc import Iterator
from statistics import NormalDist
from xml.sax.saxutils import quoteattr

import numpy as np

from cosim.spec.demand import Flow, Traffic, VehicleClass
from cosim.spec.scenario import Scenario
from cosim.spec.sumo_configuration import configuration

KRAUSS_IMPERFECTION = 0.5  # where none is given


def route_file(traffic: Traffic, seed: int, end: float) -> str:
    """SUMO's route file: vehicle types, routes and every vehicle until `end` [s], in the order of departure.

    Each demand interval gets its exact number of vehicles (the rounding error is carried over) at uniformly random
    times. This is a Poisson process with given counts.
    """
    streams = np.random.SeedSequence(seed).spawn(len(traffic.vehicles) + len(traffic.flows))
    lines = []
    for vehicles, stream in zip(traffic.vehicles, streams, strict=False):
        lines += _types(vehicles, np.random.default_rng(stream))
    lines += [
        f"    <route id={quoteattr(flow.name)} edges={quoteattr(' '.join(flow.edges))}/>" for flow in traffic.flows
    ]
    departures = [
        departure
        for flow, stream in zip(traffic.flows, streams[len(traffic.vehicles) :], strict=True)
        for departure in _departures(traffic, flow, np.random.default_rng(stream), end)
    ]
    lines += [text for _, text in sorted(departures)]
    return "\n".join(["<routes>", *lines, "</routes>", ""])


def sign_file(traffic: Traffic) -> str:
    """SUMO's additional file with the bottleneck's variable speed sign, if there is a bottleneck.

    SUMO changes the limits by itself, so that every branch of a simulation has them (SUMO doc: Variable Speed Signs).
    Limits that move are set while the simulation runs instead (`cosim.traffic.bottleneck_control`).
    """
    lines = []
    if traffic.bottleneck is not None and not traffic.bottleneck.moves:
        steps = (
            f'        <step time="{k * traffic.interval:g}" speed="{limit:g}"/>'
            for k, limit in enumerate(traffic.bottleneck.limits)
        )
        lanes = quoteattr(" ".join(traffic.bottleneck.lanes))
        lines = [f'    <variableSpeedSign id="bottleneck" lanes={lanes}>', *steps, "    </variableSpeedSign>"]
    return "\n".join(["<additional>", *lines, "</additional>", ""])


def _standard_normal(rng: np.random.Generator, n: int) -> np.ndarray:
    """The n quantiles of a standard normal distribution in random order, cut off at ±2.

    Unlike independent draws they have the same mean for every seed, so that the capacity of a road does not depend on
    the seed.
    """
    quantiles = np.array([NormalDist().inv_cdf((k + 0.5) / n) for k in range(n)])
    return np.clip(rng.permutation(quantiles), -2, 2)


def _normal(rng: np.random.Generator, mean: float, sd: float, n: int) -> np.ndarray:
    return mean + sd * _standard_normal(rng, n)


def _types(vehicles: VehicleClass, rng: np.random.Generator) -> list[str]:
    """The vType elements of one vehicle class: `variants` draws from its distributions."""
    n, lane = vehicles.variants, vehicles.lane_changing
    sigma = np.sqrt(np.log1p(vehicles.tau_cv**2))
    tau = np.maximum(vehicles.tau * np.exp(sigma * _standard_normal(rng, n) - sigma**2 / 2), vehicles.tau_min)
    length = _normal(rng, vehicles.length, vehicles.length_sd, n)
    gap = np.maximum(_normal(rng, vehicles.min_gap, vehicles.min_gap_sd, n), 0.5)
    factor = _normal(rng, vehicles.speed_factor, vehicles.speed_factor_sd, n)
    sigma = KRAUSS_IMPERFECTION if vehicles.imperfection is None else vehicles.imperfection
    model = f' sigma="{sigma:g}"' if vehicles.car_following == "Krauss" else ""
    if vehicles.imperfection_step is not None:
        model += f' sigmaStep="{vehicles.imperfection_step:g}"'
    return [
        f'    <vType id="{vehicles.name}.{k}" vClass="{vehicles.v_class}"'
        f' carFollowModel="{vehicles.car_following}"{model}'
        f' length="{length[k]:.2f}" width="{vehicles.width:g}" accel="{vehicles.acceleration:g}"'
        f' decel="{vehicles.deceleration:g}" emergencyDecel="{vehicles.emergency_deceleration:g}"'
        f' tau="{tau[k]:.3f}" minGap="{gap[k]:.2f}" speedFactor="{factor[k]:.3f}" lcStrategic="{lane.strategic:g}"'
        f' lcCooperative="{lane.cooperative:g}" lcSpeedGain="{lane.speed_gain:g}" lcKeepRight="{lane.keep_right:g}"'
        f' lcAssertive="{lane.assertive:g}"/>'
        for k in range(n)
    ]


def _counts(traffic: Traffic, flow: Flow, end: float) -> Iterator[tuple[float, float, int]]:
    """(begin, end, number of vehicles) of each demand interval."""
    begin, due = 0.0, 0.0
    for k in range(int(np.ceil(end / traffic.interval))):
        until = min(begin + traffic.interval, end)
        due += flow.per_hour[min(k, len(flow.per_hour) - 1)] * (until - begin) / 3600
        yield begin, until, round(due)
        due -= round(due)
        begin = until


def _departures(
    traffic: Traffic, flow: Flow, rng: np.random.Generator, end: float
) -> Iterator[tuple[tuple[float, str], str]]:
    """The vehicle elements of one flow, each with its sort key (time, id)."""
    variants = {vehicles.name: vehicles.variants for vehicles in traffic.vehicles}
    names, shares = list(flow.classes), np.array(list(flow.classes.values()))
    number = 0
    for begin, until, count in _counts(traffic, flow, end):
        times = np.sort(rng.uniform(begin, until, count))
        classes = rng.choice(len(names), size=count, p=shares / shares.sum())
        lanes = rng.choice(flow.lanes, size=count)
        draws = rng.random(count)
        for time, which, lane, draw in zip(times, classes, lanes, draws, strict=True):
            name, vehicle = names[which], f"{flow.name}.{number}"
            yield (
                (round(float(time), 2), vehicle),
                f'    <vehicle id="{vehicle}" type="{name}.{int(draw * variants[name])}" route="{flow.name}"'
                f' depart="{time:.2f}" departLane="{lane}" departSpeed="avg"/>',
            )
            number += 1


def arguments(scenario: Scenario, net: str, routes: str, signs: str, log: str) -> list[str]:
    """SUMO's command line for a scenario (without the program's name); `routes` and `signs` may be comma-separated.

    SUMO only reports collisions. In traffic of the scenario's own description, SUMO never teleports a vehicle, and
    overtaking on the right is allowed as on US freeways. With SUMO files of the user, all other options are theirs.
    Whole route files are read at the start. Otherwise SUMO keeps them open and reads on every 200 s; a branch shares
    the open files with the trunk, and what the one has read is missing for the other.
    """
    own = scenario.traffic.has_own_files
    described = {"default.speeddev": 0, "time-to-teleport": -1, "lanechange.overtake-right": "true"}
    options = {
        **(configuration(scenario.traffic).options if own else described),
        "net-file": net,
        "route-files": routes,
        "additional-files": signs,
        **coupling_options(scenario),
        "error-log": log,
    }
    return [token for name, value in options.items() if value != "" for token in (f"--{name}", str(value))]


def coupling_options(scenario: Scenario) -> dict[str, str | int]:
    """The options of SUMO that the coupling needs, whatever the traffic."""
    return {
        "seed": scenario.seed,
        "step-length": f"{scenario.step:g}",
        "collision.action": "warn",
        "collision.mingap-factor": 0,
        "collision.check-junctions": "true",
        "route-steps": 0,
        "no-step-log": "true",
        "duration-log.disable": "true",
        "xml-validation": "never",
    }
