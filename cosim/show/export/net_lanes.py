"""The lanes of a SUMO net in its plane, read from the net file; no simulation is needed."""

import gzip
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float, Int

from cosim.spec.input_files import GZIP, find_net
from gri.errors import guarded_reading

DEFAULT_WIDTH = 3.2  # [m], of a lane without the attribute


@dataclass(frozen=True)
class NetLane:
    """A lane: its SUMO id, its centre line [m] and its width [m]; lanes inside junctions have a colon in front."""

    name: str
    centre: Float[np.ndarray, "P 2"]
    width: float

    def side(self, offset: float) -> Float[np.ndarray, "P 2"]:
        """The line at `offset` [m] to the left of the centre line."""
        along = np.gradient(self.centre, axis=0)
        normal = np.stack([-along[:, 1], along[:, 0]], 1) / np.hypot(*along.T)[:, None].clip(1e-9)
        return self.centre + offset * normal


def net_lanes(name: str) -> tuple[NetLane, ...]:
    """The lanes of the net of that name or path. Raises `InputError` if there is none, or it cannot be read."""
    path = find_net(name)
    found = []
    with (
        guarded_reading(path, "SUMO net", "build it again with netconvert"),
        path.open("rb") as raw,
        gzip.open(raw) if raw.peek(2)[:2] == GZIP else raw as file,
    ):
        for _, element in ElementTree.iterparse(file):
            if element.tag == "lane":
                points = [[float(x) for x in point.split(",")[:2]] for point in str(element.get("shape")).split()]
                width = float(element.get("width", DEFAULT_WIDTH))
                found.append(NetLane(str(element.get("id")), np.array(points), width))
    return tuple(lane for lane in found if len(lane.centre) >= 2)


def places(
    lanes: Sequence[NetLane], xy: Float[np.ndarray, "V 2"]
) -> tuple[Int[np.ndarray, " V"], Float[np.ndarray, " V"]]:
    """For each position: the index of the lane whose centre line is nearest (−1: outside all), and pos on it [m]."""
    best, index, pos = np.full(len(xy), np.inf), np.full(len(xy), -1), np.full(len(xy), np.nan)
    for number, lane in enumerate(lanes):
        low, high = lane.centre.min(0) - lane.width, lane.centre.max(0) + lane.width
        near = np.flatnonzero(((xy >= low) & (xy <= high)).all(1))
        start = 0.0
        for a, b in zip(lane.centre[:-1], lane.centre[1:], strict=True):
            along, size = b - a, float(np.hypot(*(b - a)))
            share = ((xy[near] - a) @ along / max(size**2, 1e-12)).clip(0, 1)
            apart = np.hypot(*(xy[near] - a - share[:, None] * along).T)
            better = (apart < best[near] - 1e-9) & (apart <= lane.width / 2 + 0.1)
            rows = near[better]
            best[rows], index[rows], pos[rows] = apart[better], number, start + share[better] * size
            start += size
    return index, pos
