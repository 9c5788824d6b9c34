"""The paper's figures from the results of jobs (PNG and SVG). Numbers are the paper's: F4 … F15."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from torch import Tensor

from gri import checkpoint
from gri.data.store import scenes_of
from gri.data.synthetic.expert import true_reward
from gri.evaluation import diagnostics
from gri.evaluation import out_of_distribution as ood
from gri.evaluation.metrics import edge_frequency
from gri.evaluation.out_of_distribution import Front
from gri.paper import jobs, rows
from gri.paper.jobs import Job
from gri.paper.plots import COLOURS, STYLE, density, frequency_matrix, save

UNITS = {"x": "x [m]", "y": "y [m]", "v": "v [m/s]"}
FRONTS = {Front.CONSTANT_SPEED: "vehicle 1 at constant speed", Front.POLICY: "vehicle 1 driven by the policy"}
VEHICLE = (4.5, 1.8)  # [m], length and width of the rectangles


def draw(wanted: Sequence[Job], cache: Path, scenes: Path, curves: pd.DataFrame, out: Path) -> list[str]:
    """All figures the jobs have data for; returns their names."""
    made: list[str] = []
    with plt.rc_context(STYLE):
        for scenario in rows.SCENARIOS:
            mine = [job for job in wanted if job.scenario.name == scenario.name]
            if mine:
                for name, figure in _figures(scenario, mine, cache, scenes, curves):
                    save(figure, out, name)
                    made.append(name)
    return made


def _figures(
    scenario: rows.Scenario, mine: Sequence[Job], cache: Path, scenes: Path, curves: pd.DataFrame
) -> Iterator[tuple[str, Figure]]:
    yield f"f4_edge_frequencies_{scenario.name}", edge_frequencies(scenario, mine, cache)
    if scenario.name.endswith("_mixed"):
        return
    if len(curves):
        name = "f9_out_of_distribution" if "y" in scenario.features else "f8_success"
        yield f"{name}_{scenario.name}", success_curves(scenario, curves)
        yield f"f12_example_{scenario.name}", example(scenario, mine, cache)
    yield f"f13_std_along_horizon_{scenario.name}", std_along_horizon(scenario, mine, cache)
    drawn = _first(mine, "GRI")
    if drawn:
        yield f"f14_density_{scenario.name}", densities(drawn, cache, scenes)
    ablation = _first(mine, "GRI-VAIRL")
    if ablation:
        yield f"f15_graph_gri_vairl_{scenario.name}", edge_frequencies(scenario, [ablation], cache)


def _first(mine: Sequence[Job], row: str) -> Job | None:
    return next((job for job in mine if job.row.name == row), None)


def edge_frequencies(scenario: rows.Scenario, mine: Sequence[Job], cache: Path) -> Figure:
    """F4: one matrix per edge type and row, mean over seeds; A[i, j] is how often z_ji is that type."""
    found: dict[str, list[np.ndarray]] = {"truth": [_true_frequency(mine[0])]}
    for job in mine:
        graphs = job.result(cache)["graphs"]
        if graphs:
            found.setdefault(job.row.name, []).append(np.array(graphs["frequency"]))
    kinds = jobs.vocabulary_of(mine[0])
    size = (1.55 * len(found) + 0.3, 1.95 * len(kinds) + 0.4)
    figure, axes = plt.subplots(len(kinds), len(found), figsize=size, squeeze=False)
    for column, (name, matrices) in zip(axes.T, found.items(), strict=True):
        for axis, kind, matrix in zip(column, kinds, np.mean(matrices, 0), strict=True):
            frequency_matrix(axis, matrix, f"{name}\n{kind}")
    figure.suptitle(f"{scenario.title}: share of test scenes with the type", fontsize=9)
    figure.tight_layout(h_pad=1.5)
    return figure


def _true_frequency(job: Job) -> np.ndarray:
    shares = job.config.data.shares
    types = torch.cat([jobs.types_of(job, share.edges) for share in shares])
    weights = torch.tensor([float(share.share) for share in shares])
    parts = [edge_frequency(row[None], len(jobs.vocabulary_of(job))) for row in types]
    return torch.einsum("g,gkij->kij", weights / weights.sum(), torch.stack(parts)).numpy()


def success_curves(scenario: rows.Scenario, curves: pd.DataFrame) -> Figure:
    """F8, F9: rates against the starting headway, all seeds pooled, with 95 % bands."""
    metrics = ["success", "collision", "lateral"] if "y" in scenario.features else ["success"]
    labels = {"success": "success rate", "collision": "collision rate", "lateral": "Δy [m]"}
    figure, axes = plt.subplots(
        len(metrics), 2, figsize=(9.0, 2.6 * len(metrics) + 0.9), sharex=True, sharey="row", squeeze=False
    )
    for line, metric in zip(axes, metrics, strict=True):
        for axis, front in zip(line, Front, strict=True):
            part = curves[(curves["scenario"] == scenario.name) & (curves["front"] == front)]
            _curves(axis, part, metric, scenario)
            axis.set_ylabel(labels[metric])
    for axis, front in zip(axes[0], Front, strict=True):
        axis.set_title(FRONTS[front], fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("starting headway Δx [m]")
    axes[0][0].invert_xaxis()  # the others share it; the test gets harder to the right
    handles, names = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, names, loc="lower center", ncol=5, fontsize=7, frameon=False)
    figure.tight_layout(rect=(0, 0.5 / figure.get_figheight(), 1, 1))
    return figure


def _curves(axis: Axes, part: pd.DataFrame, metric: str, scenario: rows.Scenario) -> None:
    for name in ["oracle", *[row.name for row in scenario.rows]]:
        mine = part[part["row"] == name]
        if not len(mine):
            continue
        grouped = mine.groupby("headway")
        mean = grouped[metric].mean()
        band = grouped[f"{metric}_half_width"].mean() / np.sqrt(grouped.size())
        above = {"oracle": 4, "GRI": 3}.get(name, 2)
        style = {
            "zorder": above,
            "color": COLOURS.get(name, "black"),
            "lw": 1.4,
            "ls": "--" if name == "oracle" else "-",
        }
        axis.plot(mean.index, mean, label=name, **style)
        axis.fill_between(mean.index, mean - band, mean + band, color=style["color"], alpha=0.15, lw=0)
    if metric != "lateral":
        axis.set_ylim(-0.03, 1.03)


def std_along_horizon(scenario: rows.Scenario, mine: Sequence[Job], cache: Path) -> Figure:
    """F13: how far sampled actions spread the states."""
    figure, axes = plt.subplots(1, len(scenario.features), figsize=(3.3 * len(scenario.features) + 0.4, 3.4))
    names = list(dict.fromkeys(job.row.name for job in mine))
    for name in names:
        results = [job.result(cache)["std"]["along"] for job in mine if job.row.name == name]
        for axis, feature in zip(axes, scenario.features, strict=True):
            std = np.mean([result[feature] for result in results], 0)
            time = np.arange(len(std)) * mine[0].config.data.scene_range.dt
            shown = std > 0  # the first states are given
            axis.plot(time[shown], std[shown], label=name, color=COLOURS.get(name, "black"))
    for axis, feature in zip(axes, scenario.features, strict=True):
        axis.set_xlabel("time [s]")
        axis.set_ylabel(f"standard deviation of {UNITS[feature]}")
        axis.set_yscale("log")  # the rows are two orders of magnitude apart
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=4, fontsize=7, frameon=False)
    figure.tight_layout(rect=(0, 0.16, 1, 1))
    return figure


def densities(job: Job, cache: Path, scenes: Path, samples: int = 400) -> Figure:
    """F14: kernel density of sampled roll-outs of one test scene, vehicles 1 and 0, with the recorded one in blue."""
    splits = scenes_of(job.config.data, scenes)
    model = checkpoint.load(job.folder(cache) / "model.pt")
    scene = splits.test[:1]
    sigma = torch.tensor(job.result(cache)["std"]["sigma"])
    states = diagnostics.sampled_states(model, scene, sigma, samples)[:, 0]
    across = "y" in job.scenario.features
    figure, axes = plt.subplots(2, 1, figsize=(5.0, 5.2), sharex=True)
    for axis, vehicle in zip(axes, (1, 0), strict=True):
        place = model.dynamics.index("y" if across else "v")
        other = model.dynamics.index("x")
        points = _between(states[:, vehicle][..., [other, place]]).reshape(-1, 2).numpy()
        recorded = scene.state[0, vehicle][:, [other, place]].numpy()
        density(axis, points)
        axis.plot(recorded[:, 0], recorded[:, 1], color="blue", lw=1.2, label="recorded")
        axis.set_ylabel(UNITS["y" if across else "v"])
        axis.set_title(f"vehicle {vehicle} (colour: square root of the density)", fontsize=9)
        axis.autoscale()
    axes[0].legend(frameon=False)
    axes[-1].set_xlabel(UNITS["x"])
    figure.tight_layout()
    return figure


def _between(states: Tensor, parts: int = 8) -> Tensor:
    """Points on the straight lines between successive instants, so that the density does not show the sampling."""
    share = torch.linspace(0, 1, parts + 1)[:-1, None, None, None]
    return (1 - share) * states[:, :-1] + share * states[:, 1:]


def example(scenario: rows.Scenario, mine: Sequence[Job], cache: Path) -> Figure:
    """F12: one start out of distribution as sequences of rectangles, by GRI, NRI and Supervised."""
    headway = scenario.protocol.headways[(5 * len(scenario.protocol.headways)) // 6]
    names = ["oracle", "GRI", "Supervised", "NRI"]
    drives = {name: drive for name in names if (drive := _drive(name, mine, cache))}
    start = ood.at_headway(jobs.starts(mine[0]), headway)[:1]
    figure, axes = plt.subplots(len(drives), 1, figsize=(8.0, 1.5 * len(drives) + 0.5), sharex=True)
    for axis, (name, drive) in zip(np.atleast_1d(axes), drives.items(), strict=True):
        state = drive(start, Front.CONSTANT_SPEED)[0]
        _rectangles(axis, state - start[0, 1] * torch.eye(state.shape[-1])[0], "y" in scenario.features)
        gap = float(state[1, -1, 0] - state[0, -1, 0])
        axis.set_title(f"{name}: final headway {gap:.1f} m", fontsize=8, loc="left")
    axis.set_xlabel("x [m] from the first place of vehicle 1 (front)")
    figure.suptitle(
        f"start at Δx = {headway:+.0f} m; blue: vehicle 0, grey: vehicle 1, fading in with time", fontsize=9
    )
    figure.tight_layout()
    return figure


def _drive(name: str, mine: Sequence[Job], cache: Path) -> ood.Drive | None:
    if name == "oracle":
        scenes = mine[0].config.data.scene_range
        return ood.oracle(true_reward(scenes), jobs.dynamics_of(mine[0]), scenes.dt, scenes.steps)
    job = _first(mine, name)
    if job is None:
        return None
    types = torch.tensor(job.result(cache)["ood_types"])
    return ood.driver(checkpoint.load(job.folder(cache) / "model.pt"), types, job.config.data.scene_range.steps)


def _rectangles(axis: Axes, state: Tensor, across: bool) -> None:
    """Both vehicles every 0.8 s; in one dimension each has a line of its own, so that they can pass."""
    shown = range(0, state.shape[1], 4)
    for vehicle, colour in ((1, "0.4"), (0, "#0072B2")):
        for t in shown:
            y = float(state[vehicle, t, 1]) if across else (2.4 if vehicle == 1 else 0.0)
            x, strength = float(state[vehicle, t, 0]), 0.15 + 0.75 * t / max(shown)
            corner = (x - VEHICLE[0], y - VEHICLE[1] / 2)
            axis.add_patch(Rectangle(corner, *VEHICLE, facecolor=colour, alpha=strength, edgecolor="black", lw=0.5))
    axis.autoscale_view()
    axis.set_aspect("equal")
    axis.set_ylabel("y [m]" if across else "")
    if not across:
        axis.set_yticks([0.0, 2.4], ["0", "1"])
        axis.set_ylabel("vehicle")
