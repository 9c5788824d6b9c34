"""An episode as ASAM OpenSCENARIO XML 1.2: every vehicle follows its recorded trajectory.

Written with scenariogeneration (extra `export`). Positions are those of the middle of a vehicle's box, in SUMO's plane;
times count from the first instant. A vehicle that appears later stands at its first place until then, and one that
leaves stands at its last place: OpenSCENARIO has no vehicles that come and go by themselves.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from cosim.show.export.moving_vehicles import MovingVehicles
from gri.errors import InputError

HEIGHT, REAR_AXLE, WHEEL = 1.5, 0.3, 0.6  # [m]; REAR_AXLE is a share of the length
FASTEST = 80.0  # [m/s]


def write_openscenario(moving: MovingVehicles, path: Path, road: str = "") -> None:
    """Write the file; `road` names an OpenDRIVE file of the road, which the program that plays it may want.

    Raises `InputError` if scenariogeneration is not installed.
    """
    try:
        from scenariogeneration import xosc
    except ImportError:
        raise InputError(
            "--format openscenario: scenariogeneration is not installed; install gri-cosim[export]"
        ) from None
    entities, init = xosc.Entities(), xosc.Init()
    act = xosc.Act("drive", _at_once(xosc, "start of the act"))
    for name, rows in moving.tracks():
        centre = _centres(rows)
        entities.add_scenario_object(name, _vehicle(xosc, name, rows))
        init.add_init_action(name, xosc.TeleportAction(xosc.WorldPosition(*centre[0])))
        init.add_init_action(name, xosc.AbsoluteSpeedAction(float(rows["v"].iloc[0]), _step_change(xosc)))
        act.add_maneuver_group(_following(xosc, name, rows["time"].to_numpy() - moving.begin, centre))
    board = xosc.StoryBoard(init, _after(xosc, float(np.ptp(moving.rows["time"]))))
    board.add_act(act)
    scenario = xosc.Scenario(
        moving.name,
        "gri-cosim",
        xosc.ParameterDeclarations(),
        entities,
        board,
        xosc.RoadNetwork(roadfile=road or None),
        xosc.Catalog(),
        osc_minor_version=2,
    )
    scenario.write_xml(str(path))


def _centres(rows: pd.DataFrame) -> list[list[float]]:
    """x, y, z and heading of the middles of the boxes."""
    half, heading = rows["length"] / 2, rows["heading"]
    x, y = rows["x"] - half * np.cos(heading), rows["y"] - half * np.sin(heading)
    return np.column_stack([x, y, np.zeros(len(rows)), heading]).round(4).tolist()


def _vehicle(xosc: Any, name: str, rows: pd.DataFrame) -> Any:
    length, width = float(rows["length"].iloc[0]), float(rows["width"].iloc[0])
    box = xosc.BoundingBox(width, length, HEIGHT, 0.0, 0.0, HEIGHT / 2)
    front, rear = (xosc.Axle(0.5, WHEEL, width * 0.9, x, WHEEL / 2) for x in (length * REAR_AXLE, -length * REAR_AXLE))
    kind = xosc.VehicleCategory.truck if length > 7 else xosc.VehicleCategory.car
    return xosc.Vehicle(name, kind, box, front, rear, FASTEST, 10.0, 10.0)


def _following(xosc: Any, name: str, time: np.ndarray, centre: list[list[float]]) -> Any:
    trajectory = xosc.Trajectory(f"trajectory of {name}", False)
    places = [xosc.WorldPosition(*place) for place in centre]
    trajectory.add_shape(xosc.Polyline(time.round(4).tolist(), places))
    action = xosc.FollowTrajectoryAction(trajectory, xosc.FollowingMode.position, xosc.ReferenceContext.absolute, 1, 0)
    event = xosc.Event(f"drive {name}", xosc.Priority.override)
    event.add_action(f"follow {name}", action)
    event.add_trigger(_at_once(xosc, f"start of {name}"))
    manoeuvre = xosc.Maneuver(f"manoeuvre of {name}")
    manoeuvre.add_event(event)
    group = xosc.ManeuverGroup(f"group of {name}")
    group.add_actor(name)
    group.add_maneuver(manoeuvre)
    return group


def _step_change(xosc: Any) -> Any:
    return xosc.TransitionDynamics(xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0)


def _at_once(xosc: Any, name: str) -> Any:
    condition = xosc.SimulationTimeCondition(0, xosc.Rule.greaterOrEqual)
    return xosc.ValueTrigger(name, 0, xosc.ConditionEdge.none, condition)


def _after(xosc: Any, seconds: float) -> Any:
    condition = xosc.SimulationTimeCondition(seconds, xosc.Rule.greaterThan)
    return xosc.ValueTrigger("end", 0, xosc.ConditionEdge.none, condition, "stop")
