"""Draw a net with its study area, lanes and ramps labelled: `python sumo_nets/draw.py us101`.

Lengths are to scale. Widths are exaggerated: to scale, 22 m of road would be a line beside its 1,650 m.
"""

import argparse
from pathlib import Path

import sumolib
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Polygon
from sumolib.net import Net
from sumolib.net.lane import Lane

HERE = Path(__file__).parent
TITLES = {"us101": "US-101 southbound, Los Angeles", "i80": "I-80 eastbound, Emeryville"}
MAINLINE = {
    "us101": ("upstream", "entry", "weave", "exit", "downstream_free", "downstream"),
    "i80": ("upstream", "entry", "merge", "exit", "downstream_free", "downstream"),
}
ADDED_LANE = {"us101": "lane 6 (auxiliary)", "i80": "lane 7 (acceleration)"}
RAMPS = {"on_ramp": {"us101": "Ventura Blvd", "i80": "Powell St"}, "off_ramp": {"us101": "Cahuenga Blvd"}}
ORDINARY, ADDED, HOV, SLOWED = "#d4d4d4", "#f0c36d", "#9fc5e8", "#cdbbd9"
GREY, FONT = "#444444", 8
NARROW = 90  # [m]; the label of a shorter edge goes one row up


def colour(lane: Lane) -> str:
    """Fill colour of a lane: what it is for."""
    edge = lane.getEdge().getID()
    if not lane.allows("passenger"):
        return HOV
    if edge in RAMPS or lane.isAccelerationLane():
        return ADDED
    return SLOWED if edge == "downstream" else ORDINARY


def draw_lanes(ax: Axes, net: Net) -> None:
    """Every lane as a band of its own width."""
    for edge in net.getEdges():
        for lane in edge.getLanes():
            half, shape = lane.getWidth() / 2, lane.getShape()
            band = [(x, y + half) for x, y in shape] + [(x, y - half) for x, y in reversed(shape)]
            ax.add_patch(Polygon(band, facecolor=colour(lane), edgecolor="white", linewidth=1.0))


def dimension(ax: Axes, begin: float, end: float, y: float, text: str, **style: object) -> None:
    """A dimension line with its text above it."""
    arrow = {"arrowstyle": "<->", "color": GREY, "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", (end, y), (begin, y), arrowprops=arrow)
    ax.text((begin + end) / 2, y + 0.8, text, ha="center", va="bottom", **{"fontsize": FONT, **style})


def label_edges(ax: Axes, net: Net, site: str) -> None:
    """Names and lengths of the mainline edges above the road, the study area, node positions below."""
    begin, end = net.getNode("study_begin").getCoord()[0], net.getNode("study_end").getCoord()[0]
    ax.axvspan(begin, end, color="#eef5ea", zorder=0)
    dimension(ax, begin, end, 17, f"study area, {end - begin:g} m", fontweight="bold", fontsize=FONT + 2)
    for name in MAINLINE[site]:
        edge = net.getEdge(name)
        left, right = edge.getFromNode().getCoord()[0], edge.getToNode().getCoord()[0]
        row = 8.5 if right - left < NARROW else 3
        dimension(ax, left, right, row, f"{name}, {edge.getLength():g} m")
        ax.vlines([left, right], 0.5, row + 0.5, color=GREY, linewidth=0.6)
    nodes = [net.getEdge(name).getFromNode() for name in MAINLINE[site]] + [net.getNode("sink")]
    ticks = [node.getCoord()[0] for node in nodes]
    ax.set_xticks(ticks, [f"{x:g}" for x in ticks])
    ax.tick_params(axis="x", labelsize=FONT)


def label_lanes(ax: Axes, net: Net, site: str) -> None:
    """NGSIM lane numbers before the study entry, SUMO lane ids where an edge begins."""
    for number, lane in enumerate(reversed(net.getEdge("entry").getLanes()), start=1):
        text = f"lane {number}" if lane.allows("passenger") else f"lane {number} (HOV)"
        ax.text(-8, lane.getShape()[0][1], text, ha="right", va="center", fontsize=FONT, fontweight="bold")
    for name in MAINLINE[site]:
        if name == "downstream_free":  # too short for its lane ids
            continue
        for lane in net.getEdge(name).getLanes():
            x, y = lane.getShape()[0]
            ax.text(x + 6, y, lane.getID(), va="center", fontsize=FONT - 1, color=GREY)


def label_ramps(ax: Axes, net: Net, site: str) -> None:
    """The added lane below the road, each ramp beside its outer end."""
    added = net.getEdge(MAINLINE[site][2]).getLanes()[0]
    (begin, y), (end, _) = added.getShape()[0], added.getShape()[-1]
    dimension(ax, begin, end, y - 7, "")
    ax.text(begin, y - 8, f"{ADDED_LANE[site]}, {added.getLength():g} m", va="top", fontsize=FONT)
    for ramp, streets in RAMPS.items():
        if site in streets:
            shape = net.getEdge(ramp).getLanes()[0].getShape()
            (x, y), align, gap = (shape[0], "right", -12) if ramp == "on_ramp" else (shape[-1], "left", 12)
            text = f"{ramp} ({streets[site]})\n{net.getEdge(ramp).getLength():.0f} m"
            ax.text(x + gap, y, text, ha=align, va="center", fontsize=FONT)


def draw(site: str) -> Path:
    """Write the picture beside the net and return its path."""
    net = sumolib.net.readNet(str(HERE / site / f"{site}.net.xml"))
    figure, ax = plt.subplots(figsize=(15, 4.8), layout="constrained")
    draw_lanes(ax, net)
    label_edges(ax, net, site)
    label_lanes(ax, net, site)
    label_ramps(ax, net, site)
    kinds = {
        "mainline lane": ORDINARY,
        "ramp, auxiliary or acceleration lane": ADDED,
        "limit lowered at run time": SLOWED,
        "HOV lane": HOV,
    }
    used = {colour(lane) for edge in net.getEdges() for lane in edge.getLanes()}
    handles = [Patch(color=shade, label=kind) for kind, shade in kinds.items() if shade in used]
    ax.legend(handles=handles, loc="lower right", fontsize=FONT, frameon=False)
    ax.set(ylim=(-70, 24), yticks=[], xlabel="x [m] from the study area's entry; traffic runs to the right")
    ax.set_title(TITLES[site], loc="left", fontweight="bold")
    ax.spines[["left", "right", "top"]].set_visible(False)
    ax.margins(x=0.01)
    path = HERE / site / f"{site}.png"
    figure.savefig(path, dpi=130, metadata={"Software": None})
    plt.close(figure)
    return path


def main() -> None:
    """Draw the site named on the command line."""
    parser = argparse.ArgumentParser(description="Draw a net beside its net file.")
    parser.add_argument("site", choices=TITLES)
    print(f"wrote {draw(parser.parse_args().site)}")


if __name__ == "__main__":
    main()
