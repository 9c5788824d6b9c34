"""Propose scenarios for a SUMO configuration: look at its net and its traffic, then write the files."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cosim.loop.closed_loop import run
from cosim.proposals.main_road import MainRoad, main_road
from cosim.proposals.net_file import NetLanes, read_net_lanes
from cosim.proposals.placed_road import placed
from cosim.proposals.scenario_file import Choice, choices, scenario_text
from cosim.spec.demand import Traffic
from cosim.spec.input_files import find_net
from cosim.spec.scenario import CarFollowing, LeftToSumo, Road, Scenario
from cosim.spec.sumo_configuration import Configuration, configuration
from cosim.sumo import sumo
from cosim.sumo.net_use import NetUse, observe_net_use
from cosim.traffic.scratch_files import scratch_files
from cosim.traffic.simulation_input import prepare_simulation
from gri.errors import InputError

Tell = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Proposal:
    """A proposed scenario: its text, and what it was made from."""

    text: str
    choice: Choice


@dataclass(frozen=True)
class Proposals:
    """Scenarios that fit a configuration, the one to be preferred first, and what they were made from."""

    each: tuple[Proposal, ...]
    net: NetLanes
    road: MainRoad
    given: Configuration


def observe(path: Path, seconds: float, step: float, tell: Tell) -> NetUse:
    """Run the configuration alone for `seconds` and count its traffic. Runs in a worker process."""
    given = configuration(Traffic(sumocfg=str(path)))
    if given.net is None:
        raise InputError(f"{path}: it names no net-file; add one")
    edge = next(iter(read_net_lanes(given.net).of_edge))
    scenario = Scenario(
        net=str(given.net),
        road=Road(edges=(edge,), origin=edge, length=1.0),
        traffic=Traffic(sumocfg=str(path), warm_up=0.0),
        group=CarFollowing(),
        policy=LeftToSumo(),
        step=step,
    )
    steps = round(seconds / step)
    with scratch_files(find_net(scenario.net), what=f"{path}: SUMO refused it") as files:
        inputs = prepare_simulation(scenario, files, seconds)
        inputs.write()
        tell("traffic", 0, steps)
        with sumo(inputs.arguments, files.log) as world:
            return observe_net_use(world, steps, step, tell)


def proposals(path: Path, beside: Path, use: NetUse, rule: str | None) -> Proposals:
    """Scenario files that lie in the folder `beside`. `rule` is car_following, merge, or None for both.

    Raises `InputError` if there is no road, or no lane on which vehicles could merge although `rule` says merge.
    """
    given = configuration(Traffic(sumocfg=str(path)))
    assert given.net is not None, "the traffic was observed on a net"
    net = read_net_lanes(given.net)
    road = placed(main_road(net, use.routes), given.net)
    fitting = [choice for choice in choices(road, use) if rule in (None, choice.rule)]
    if not fitting:
        raise InputError(
            f"{path}: no lane ends on the main road, and no ramp joins {' '.join(road.edges)}; wanted one for --rule"
            " merge. Use --rule car_following"
        )
    name, folder = Path(path).resolve(), beside.resolve()
    written = str(name.relative_to(folder) if name.is_relative_to(folder) else name)
    demand = None if given.end is None else given.end - given.begin
    return Proposals(
        tuple(Proposal(scenario_text(written, road, use, choice, demand), choice) for choice in fitting),
        net,
        road,
        given,
    )


def count_groups(scenario: Scenario, tell: Tell) -> int:
    """How many groups the traffic has for a scenario, of its number of episodes. Runs in a worker process."""
    with scratch_files(find_net(scenario.net)) as files:
        return len(run(scenario, files, None, tell).episodes)
