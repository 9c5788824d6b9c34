"""Starting SUMO from a `SimulationInput`, and what is known of the simulation while it runs."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from cosim.spec.demand import Bottleneck
from cosim.spec.scenario import Merge, Replay, Road, Scenario
from cosim.sumo import Sumo, sumo
from cosim.traffic.bottleneck_control import BottleneckControl
from cosim.traffic.replay import RecordedVehicles
from cosim.traffic.simulation_input import SimulationInput
from cosim.world.groups import MergeLanes
from cosim.world.joining_ramps import joining_lanes
from cosim.world.merging_lanes import merging_lanes
from cosim.world.road_frame import RoadFrame
from gri.errors import InputError

ROUNDING = 1.0  # [m] that a road may be too short for its stated length; lanes of junctions are not in its line


@dataclass(frozen=True)
class RunningSimulation:
    """A running simulation, the frame of its main road, its merging lanes and its recorded vehicles, if any."""

    world: Sumo
    frame: RoadFrame
    lanes: MergeLanes | None
    recorded: RecordedVehicles | None


@contextmanager
def simulation(inputs: SimulationInput) -> Iterator[RunningSimulation]:
    """Start SUMO on files that are written already, and check the scenario against its net.

    Raises InputError where the net lacks an edge or a lane of the scenario, or where the edges of the road do not join
    or are too short; SumoError where SUMO refuses.
    """
    scenario = inputs.scenario
    with sumo(inputs.arguments, inputs.files.log) as world:
        frame = _road(world, scenario.road, inputs.files.net)
        if inputs.friction is not None:
            world.slow_before_bends(inputs.friction)
        if (bottleneck := inputs.bottleneck) is not None:
            _check_bottleneck(world, bottleneck, inputs.files.net)
            interval, end = scenario.traffic.interval, inputs.end
            control = BottleneckControl(world, bottleneck, interval, scenario.seed, end, scenario.step)
            world.before_step = control.before_step
        recorded = None
        if isinstance(scenario.background, Replay):
            recorded = RecordedVehicles(
                world, frame, inputs.tracks, scenario.step, scenario.background, scenario.traffic
            )
            world.before_step = recorded.move
        yield RunningSimulation(world, frame, _merge_lanes(world, frame, scenario), recorded)


def _road(world: Sumo, road: Road, net: Path) -> RoadFrame:
    """The frame of the main road, once it is checked."""
    known = world.net.edges()
    if missing := [edge for edge in road.edges if edge not in known]:
        raise InputError(f"road.edges: the net {net} has no edge {missing[0]!r}; name edges of this net")
    for edge, following in pairwise(road.edges):
        if not world.net.leads_to(edge, following):
            raise InputError(
                f"road.edges: in the net {net} edge {edge!r} does not lead to edge {following!r};"
                " name the edges in the direction of driving, without a gap"
            )
    frame = world.net.road(road.edges, road.origin)
    if road.length > frame.end + ROUNDING:
        raise InputError(
            f"road.length: got {road.length:g} m, but from the beginning of edge {road.origin!r} to the end of edge"
            f" {road.edges[-1]!r} there are {frame.end:.1f} m; give at most that, or more edges"
        )
    return frame


def _check_bottleneck(world: Sumo, bottleneck: Bottleneck, net: Path) -> None:
    """Refuse lanes and edges that the net lacks; where limits do not move, SUMO refuses the lanes itself."""
    edges = bottleneck.hold.edges if bottleneck.hold is not None else ()
    if missing := [edge for edge in edges if edge not in world.net.edges()]:
        raise InputError(f"bottleneck.hold.edges: the net {net} has no edge {missing[0]!r}; name edges of this net")
    if missing := [lane for lane in bottleneck.lanes if lane not in world.net.lanes]:
        raise InputError(f"bottleneck.lanes: the net {net} has no lane {missing[0]!r}; name lanes of this net")


def _merge_lanes(world: Sumo, road: RoadFrame, scenario: Scenario) -> MergeLanes | None:
    """The lanes of a merge rule in the road frame; None for other rules."""
    rule = scenario.group
    if not isinstance(rule, Merge):
        return None
    net, edges = world.net, scenario.road.edges
    if rule.lane in net.lanes and rule.lane[0] != ":" and net.lanes[rule.lane].edge not in edges:
        return joining_lanes(net.lanes, net.entering, edges, rule.lane, road)
    return merging_lanes(net.lanes, net.lane_count, edges, rule.lane, road, across_edges=rule.across_edges)
