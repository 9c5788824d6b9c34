"""An episode as SUMO's FCD output (SUMO doc: Simulation/Output/FCDOutput), and the vehicle types that it names."""

from contextlib import suppress
from xml.sax.saxutils import quoteattr

import numpy as np

from cosim.show.export.moving_vehicles import MovingVehicles
from cosim.show.export.net_lanes import NetLane, net_lanes, places
from cosim.world.road_frame import sumo_angle_of
from gri.errors import InputError

LONG = 7.0  # [m]; longer vehicles are trucks


def fcd(moving: MovingVehicles) -> str:
    """The XML text. Vehicles have the attributes of SUMO's own output; lane and pos where they are on a lane."""
    rows = moving.rows
    lanes: tuple[NetLane, ...] = ()
    with suppress(InputError):  # the net is not on this machine
        lanes = net_lanes(moving.net)
    index, pos = places(lanes, rows[["x", "y"]].to_numpy(float))
    lane_names = [lane.name for lane in lanes]
    kinds = [type_name(*size) for size in zip(rows["length"], rows["width"], strict=True)]
    parts = ['<?xml version="1.0" encoding="UTF-8"?>', "<fcd-export>"]
    times, names = rows["time"].to_numpy(), rows["vehicle"].to_numpy()
    values = rows[["x", "y", "heading", "v", "a"]].to_numpy(float).tolist()
    for k, (x, y, heading, v, a) in enumerate(values):
        if not k or times[k] != times[k - 1]:
            parts += ["    </timestep>"] * bool(k) + [f'    <timestep time="{times[k]:.2f}">']
        place = f' pos="{pos[k]:.2f}" lane={quoteattr(lane_names[index[k]])}' if index[k] >= 0 else ""
        parts.append(
            f'        <vehicle id={quoteattr(str(names[k]))} x="{x:.3f}" y="{y:.3f}"'
            f' angle="{sumo_angle_of(heading):.3f}" type="{kinds[k]}" speed="{v:.3f}"{place} slope="0.00"'
            f' acceleration="{a:.3f}"/>'
        )
    parts += ["    </timestep>"] * bool(len(values)) + ["</fcd-export>", ""]
    return "\n".join(parts)


def vehicle_types(moving: MovingVehicles) -> str:
    """An additional file with a vehicle type for each size, to read the FCD output with."""
    sizes = np.unique(moving.rows[["length", "width"]].to_numpy(float).round(2), axis=0).tolist()
    types = [
        f'    <vType id="{type_name(length, width)}" vClass="{"truck" if length > LONG else "passenger"}"'
        f' length="{length:.2f}" width="{width:.2f}"/>'
        for length, width in sizes
    ]
    return "\n".join(["<additional>", *types, "</additional>", ""])


def type_name(length: float, width: float) -> str:
    """The name of the vehicle type of that size [m]."""
    return f"size_{length:.2f}x{width:.2f}"
