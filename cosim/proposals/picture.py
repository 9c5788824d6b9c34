"""A picture of the main road with its lanes, ramps and the range in which groups are taken over."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from cosim.proposals.main_road import MainRoad
from cosim.proposals.net_file import NetLanes
from cosim.proposals.scenario_file import Choice

GREY, BLUE, ORANGE = "0.75", "#1f5fbf", "#d9730d"


def draw_road(net: NetLanes, road: MainRoad, choice: Choice, path: Path) -> None:
    """Draw the net in grey, the main road in blue, the ending lane in orange, and write a PNG file."""
    figure, axes = plt.subplots(figsize=(9, 4.5), layout="constrained")
    for of_net in net.lanes.values():
        on_road = of_net.edge in road.edges
        ends = choice.lane is not None and of_net.id == choice.lane.lane
        x, y = zip(*of_net.shape, strict=True)
        style = {"color": ORANGE if ends else BLUE if on_road else GREY, "lw": 2.5 if ends else 1.5 if on_road else 0.8}
        axes.plot(x, y, ls="--" if ends else "-", **style)
    for edge in road.edges:
        shape = net.lanes[net.of_edge[edge][-1]].shape
        k = (len(shape) - 1) // 2
        (x_0, y_0), (x_1, y_1) = shape[k], shape[-1 - k]
        middle = (x_0 + x_1) / 2, (y_0 + y_1) / 2
        axes.annotate(edge, middle, xytext=(0, 8), textcoords="offset points", fontsize=7, color=BLUE, ha="center")
    start = net.lanes[net.of_edge[road.edges[0]][-1]].shape[0]
    axes.plot(*start, "o", color=BLUE)
    axes.annotate("s = 0", start, xytext=(0, -14), textcoords="offset points", fontsize=8)
    axes.set(xlabel="x [m]", ylabel="y [m]", title=_title(choice))
    axes.set_aspect("equal", adjustable="datalim")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _title(choice: Choice) -> str:
    if choice.lane is None:
        return "Main road (blue)"
    begin, end = choice.zone
    return f"Main road (blue); lane {choice.lane.lane} ends (orange); take-over at s = {begin} to {end} m"
