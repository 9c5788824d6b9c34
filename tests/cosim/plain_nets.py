"""Small nets for tests, built by netconvert from a few lines."""

import subprocess
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from cosim.runs.lanes import is_left_hand, lanes_of, parse_net
from cosim.world.road_frame import RoadFrame
from cosim.world.road_lanes import RoadLane, frame_along

NODES = {"a": "0,0", "b": "400,0", "c": "700,0", "d": "1200,0", "r": "200,-75"}
MERGE = {"up": "a b 2", "acc": "b c 3", "down": "c d 2", "ramp": "r b 1"}
MERGE_LINKS = ("up_0 acc_1", "up_1 acc_2", "ramp_0 acc_0", "acc_1 down_0", "acc_2 down_1")


def build_net(
    folder: Path,
    nodes: dict[str, str] = NODES,
    edges: dict[str, str] = MERGE,
    links: Sequence[str] = MERGE_LINKS,
    options: Sequence[str] = (),
) -> Path:
    """A net file of nodes "x,y[,z[,type]]", edges "from to lanes [shape]" and links "lane lane" (or its own)."""
    folder.mkdir(parents=True, exist_ok=True)
    axes = ("x", "y", "z", "type")
    node = [
        f'<node id="{name}" {" ".join(f"{a}={v!r}" for a, v in zip(axes, at.split(","), strict=False))}/>'.replace(
            "'", '"'
        )
        for name, at in nodes.items()
    ]
    edge = []
    for name, text in edges.items():
        begin, end, count, *shape = text.split(" ", 3)
        bend = f' shape="{shape[0]}"' if shape else ""
        edge.append(f'<edge id="{name}" from="{begin}" to="{end}" numLanes="{count}" speed="25"{bend}/>')
    link = []
    for text in links:
        (one, first), (other, last) = (lane.rsplit("_", 1) for lane in text.split())
        link.append(f'<connection from="{one}" to="{other}" fromLane="{first}" toLane="{last}"/>')
    files = {"nodes": node, "edges": edge, **({"connections": link} if link else {})}
    for kind, lines in files.items():
        (folder / f"{kind}.xml").write_text(f"<{kind}>{''.join(lines)}</{kind}>")
    inputs = [f"--{kind[:-1]}-files={folder / kind}.xml" for kind in files]
    net = folder / "plain.net.xml"
    subprocess.run(["netconvert", *inputs, "-o", str(net), *options], check=True, capture_output=True)
    return net


def read(net: Path, edges: Sequence[str], origin: str = "") -> tuple[dict[str, RoadLane], Counter[str], RoadFrame]:
    """The lanes of a net file, their number by edge, and the frame of a road in it."""
    root = parse_net(net)
    lanes = lanes_of(root)
    count = Counter(lane.edge for lane in lanes.values())
    frame = frame_along(lanes, count.__getitem__, edges, origin or edges[0], mirrored=is_left_hand(root))
    return lanes, count, frame
