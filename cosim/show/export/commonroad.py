"""An episode as CommonRoad XML, version 2020a: lanelets of the net's lanes and a dynamic obstacle for every vehicle.

Positions are those of the middle of a vehicle's box, in SUMO's plane; time steps count from the first instant. Written
here and not with commonroad-io, because that demands one version of protobuf, which excludes the extra `cluster`. A
test reads the file with commonroad-io.
"""

from contextlib import suppress
from datetime import date
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

import numpy as np
import pandas as pd

from cosim.show.export.moving_vehicles import MovingVehicles
from cosim.show.export.net_lanes import NetLane, net_lanes
from gri.errors import InputError

LONG = 7.0  # [m]; longer vehicles are trucks


def write_commonroad(moving: MovingVehicles, path: Path) -> None:
    """Write the file. Without the net on this machine it has no lanelets."""
    root = Element(
        "commonRoad", timeStepSize=f"{moving.step:g}", commonRoadVersion="2020a", author="gri-cosim", affiliation="",
        source="SUMO", benchmarkID="ZAM_GriCosim-1_1_T-1", date=date.today().isoformat(),
    )  # fmt: skip
    location = SubElement(root, "location")
    for name, value in (("geoNameId", "-999"), ("gpsLatitude", "999"), ("gpsLongitude", "999")):
        SubElement(location, name).text = value
    SubElement(SubElement(root, "scenarioTags"), "simulated")
    lanes: tuple[NetLane, ...] = ()
    with suppress(InputError):  # the net is not on this machine
        lanes = net_lanes(moving.net)
    for number, lane in enumerate(lanes):
        _lanelet(root, number + 1, lane)
    for number, (_, rows) in enumerate(moving.tracks()):
        _obstacle(root, len(lanes) + 1 + number, rows, moving)
    indent(root)
    ElementTree(root).write(path, encoding="UTF-8", xml_declaration=True)


def _lanelet(root: Element, number: int, lane: NetLane) -> None:
    lanelet = SubElement(root, "lanelet", id=str(number))
    for name, offset in (("leftBound", lane.width / 2), ("rightBound", -lane.width / 2)):
        bound = SubElement(lanelet, name)
        for x, y in lane.side(offset).tolist():
            _point(bound, x, y)
        SubElement(bound, "lineMarking").text = "unknown"
    SubElement(lanelet, "laneletType").text = "highway"


def _obstacle(root: Element, number: int, rows: pd.DataFrame, moving: MovingVehicles) -> None:
    length, width = float(rows["length"].iloc[0]), float(rows["width"].iloc[0])
    obstacle = SubElement(root, "dynamicObstacle", id=str(number))
    SubElement(obstacle, "type").text = "truck" if length > LONG else "car"
    shape = SubElement(SubElement(obstacle, "shape"), "rectangle")
    SubElement(shape, "length").text, SubElement(shape, "width").text = f"{length:.4f}", f"{width:.4f}"
    step = ((rows["time"] - moving.begin) / moving.step).round().astype(int)
    heading = rows["heading"].to_numpy(float)
    x, y = (rows[name] - length / 2 * turn(heading) for name, turn in (("x", np.cos), ("y", np.sin)))
    states = zip(step, x, y, heading, rows["v"], rows["a"], strict=True)
    _state(SubElement(obstacle, "initialState"), *next(states))
    trajectory = SubElement(obstacle, "trajectory")
    for values in states:
        _state(SubElement(trajectory, "state"), *values)
    if not len(trajectory):
        obstacle.remove(trajectory)


def _state(state: Element, step: int, x: float, y: float, heading: float, v: float, a: float) -> None:
    _point(SubElement(state, "position"), x, y)
    for name, value in (("orientation", heading), ("time", step), ("velocity", v), ("acceleration", a)):
        SubElement(SubElement(state, name), "exact").text = str(int(value)) if name == "time" else f"{value:.6f}"


def _point(parent: Element, x: float, y: float) -> None:
    point = SubElement(parent, "point")
    SubElement(point, "x").text, SubElement(point, "y").text = f"{x:.4f}", f"{y:.4f}"
