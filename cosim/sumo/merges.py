"""Where other roads join a road."""

from collections.abc import Sequence

import libsumo
import numpy as np

from cosim.world.road_frame import RoadFrame


def merges(edges: Sequence[str], frame: RoadFrame) -> list[tuple[float, float]]:
    """From where to where [m along the road] vehicles merge: the edges of the road that lanes of other edges lead to.

    The first edge is no merge.
    """
    inside = set(edges)
    joined = set()
    for lane in libsumo.lane.getIDList():
        edge = libsumo.lane.getEdgeID(lane)
        if edge in inside or edge.startswith(":"):
            continue
        joined |= {link[0].rpartition("_")[0] for link in libsumo.lane.getLinks(lane)}
    found = []
    for edge in edges[1:]:
        if edge in joined:
            shape = libsumo.lane.getShape(f"{edge}_{libsumo.edge.getLaneNumber(edge) - 1}")
            s, _ = frame.to_road(np.array(shape, dtype=float))
            found.append((float(s[0]), float(s[-1])))
    return found
