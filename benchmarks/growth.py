"""How the cost of a step grows with the vehicles around and with the driven groups, on one straight freeway.

    python benchmarks/growth.py [--out docs/images] [--vehicles 300,1000,3000,13000] [--groups 1,3,10,30,100]
    python benchmarks/growth.py --write freeway     # only the road with 1,200 vehicles, to run `freeway/road.yaml`

Six lanes, a vehicle every 40 m of each lane, as long as it takes. Ten groups drive among more and more vehicles; then
one to a hundred groups among 3,000. Both sides of each figure are branches of one simulation that take turns
(`step_cost.py`). The fits are straight lines; the greatest deviation from them is printed. Times are CPU times.
"""

import argparse
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
import torch
from matplotlib import pyplot as plt
from msgspec.structs import replace
from step_cost import compare

from cosim.loop.driving import Driver
from cosim.loop.trunk import Trunk
from cosim.runs.policy_loading import driver_of
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.traffic.running_simulation import simulation
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from cosim.traffic.warm_up import warm_up
from gri.table import markdown_table

LANES, HEADWAY = 6, 40.0  # [m] from front to front in a lane
AHEAD = 2_000.0  # [m] of empty road ahead of the first vehicle
SCENARIO = """\
net: road.net.xml
road: {{edges: [road], origin: road, length: {length}}}
traffic: {{routes: [road.rou.xml], warm_up: 10}}
group: {{rule: car_following, min_gap: 2, max_gap: 45, max_time_gap: 2.5, min_speed: 1, max_speed_difference: 4}}
policy: {{kind: {policy}}}
horizon: 8.0
watch: 10.0
episodes: 30
max_work: 1000
groups_at_once: {groups}
"""


@dataclass(frozen=True)
class Cost:
    """CPU milliseconds per step of SUMO alone and with groups driven; their numbers."""

    vehicles: int
    groups: int
    bare: float
    driven: float

    @property
    def own(self) -> float:
        """What is not SUMO's."""
        return self.driven - self.bare


def write_files(folder: Path, vehicles: int, groups: int, policy: str) -> Path:
    """A road full of vehicles, and the scenario that drives groups of them."""
    length = round(vehicles / LANES * HEADWAY + AHEAD)
    (folder / "n.nod.xml").write_text(f'<nodes><node id="a" x="0" y="0"/><node id="b" x="{length}" y="0"/></nodes>')
    (folder / "e.edg.xml").write_text(
        f'<edges><edge id="road" from="a" to="b" numLanes="{LANES}" speed="20" length="{length}"/></edges>'
    )
    files = "--node-files", folder / "n.nod.xml", "--edge-files", folder / "e.edg.xml"
    command = ["netconvert", *files, "--output-file", folder / "road.net.xml"]
    subprocess.run(command, check=True, capture_output=True)
    rng, lines = np.random.default_rng(1), []
    for k in range(vehicles):
        place = k // LANES * HEADWAY + rng.uniform(5.5, 15.0)
        lines.append(
            f'<vehicle id="v{k}" route="r" depart="0" departPos="{place:.1f}" departLane="{k % LANES}"'
            f' departSpeed="{rng.uniform(14, 16):.1f}"/>'
        )
    lines.append("</routes>")
    head = '<routes><route id="r" edges="road"/>'
    (folder / "road.rou.xml").write_text("\n".join([head, *lines]))
    path = folder / "road.yaml"
    path.write_text(SCENARIO.format(length=length - 10, policy=policy, groups=groups))
    return path


def measure(vehicles: int, groups: int, policy: str) -> Cost:
    """The median of seven pairs of branches of one simulation."""
    with tempfile.TemporaryDirectory() as scratch:
        scenario = load_scenario(str(write_files(Path(scratch), vehicles, groups, policy)))
        scenario = replace(scenario, watch=0.0)
        driver = driver_of(scenario)
        assert isinstance(driver, Driver)
        files = SumoFiles(find_net(scenario.net), Path(scratch, "r.rou.xml"), Path(scratch, "sumo.log"))
        inputs = prepare_simulation(scenario, files, scenario.time_limit)
        inputs.write()
        with simulation(inputs) as running:
            trunk = Trunk(running, inputs.scenario, warm_up(running.world, inputs.scenario, lambda *_: None))
            history = trunk.observe_history()
            this_round = trunk.find_groups(history, limit=groups)
            bare, driven, _ = compare(running, history, this_round, driver)
            return Cost(len(history[-1].ids), len(this_round.groups), 1e3 * bare, 1e3 * driven)


def line(x: list[float], y: list[float]) -> tuple[float, float, float]:
    """Slope and offset of the straight line that is least off in shares of y, and how much it is off at most."""
    design, values = np.stack([x, np.ones(len(x))], 1), np.asarray(y)
    slope, offset = np.linalg.lstsq(design / values[:, None], np.ones(len(x)), rcond=None)[0]
    return float(slope), float(offset), float(np.abs(slope * np.asarray(x) + offset - values).max() / values.max())


def picture(sweeps: dict[str, list[Cost]], out: Path) -> None:
    """Both sweeps: SUMO's step, and what the driven groups add."""
    mpl.rcParams["svg.hashsalt"] = "growth"
    figure, panels = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
    for axes, (what, costs) in zip(panels, sweeps.items(), strict=True):
        x = [float(getattr(cost, what)) for cost in costs]
        for name, values, style in (
            ("SUMO alone", [cost.bare for cost in costs], "ko:"),
            ("added by driven groups", [cost.own for cost in costs], "C0s"),
        ):
            axes.loglog(x, values, style, label=name, fillstyle="none" if style == "ko:" else "full")
        slope, offset, _ = line(x, [cost.own for cost in costs])
        dense = np.geomspace(min(x), max(x), 50)
        axes.loglog(dense, slope * dense + offset, "C0-", label="straight line")
        axes.set(
            xlabel=f"{what}, {'10 groups' if what == 'vehicles' else 'among 3,000 vehicles'}", ylabel="CPU ms per step"
        )
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:,g}")
            axis.set_minor_formatter("")
        axes.set_yticks([1, 2, 5, 10, 20, 50])
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    figure.savefig(out / "growth.svg", metadata={"Date": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder for the picture")
    parser.add_argument("--vehicles", default="300,1000,3000,13000")
    parser.add_argument("--groups", default="1,3,10,30,100")
    parser.add_argument("--policy", default="gri, checkpoint: us101_car_following")
    parser.add_argument("--write", type=Path, help="folder for the files of one road; measures nothing")
    options = parser.parse_args()
    if options.write:
        options.write.mkdir(parents=True, exist_ok=True)
        write_files(options.write, 1200, 6, options.policy)
        return
    torch.set_num_threads(1)
    sweeps: dict[str, list[Cost]] = {"vehicles": [], "groups": []}
    cases = [("vehicles", int(n), 10) for n in options.vehicles.split(",")]
    cases += [("groups", 3000, int(n)) for n in options.groups.split(",")]
    for what, vehicles, groups in cases:
        cost = measure(vehicles, groups, options.policy)
        sweeps[what].append(cost)
        print(
            f"{cost.vehicles} vehicles, {cost.groups} groups: bare {cost.bare:.2f} ms, driven {cost.driven:.2f} ms",
            flush=True,
        )
    for what, costs in sweeps.items():
        slope, offset, off = line([float(getattr(cost, what)) for cost in costs], [cost.own for cost in costs])
        print(f"added: {offset:.2f} ms + {1e3 * slope:.2f} µs × {what}; at most {100 * off:.0f} % of the greatest off")
    rows = [
        [f"{c.vehicles:,}", str(c.groups), f"{c.bare:.2f}", f"{c.own:.2f}", f"{c.driven / c.bare:.2f}"]
        for costs in sweeps.values()
        for c in costs
    ]
    print(markdown_table(["vehicles", "groups", "SUMO alone [ms]", "added [ms]", "driven ÷ alone"], rows))
    if options.out:
        picture(sweeps, options.out)


if __name__ == "__main__":
    main()
