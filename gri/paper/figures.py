"""The paper's figures from the results of jobs, as PNG and SVG. Names begin with the paper's numbers: f4 to f15."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from torch import Tensor

from gri import checkpoint
from gri.core.graph import InteractionGraph
from gri.data.store import scenes_of
from gri.evaluation import diagnostics
from gri.evaluation import out_of_distribution as ood
from gri.evaluation.metrics import edge_frequency
from gri.evaluation.out_of_distribution import Front
from gri.evaluation.recorded_scores import pooled_rate
from gri.paper.job_cache import Job, scenarios_of
from gri.paper.plots import STYLE, curve, density, frequency_matrices, legend_below, line, panels, save, styles
from gri.paper.rows import Scenario
from gri.paper.score_frames import STAGES, rates
from gri.paper.synthetic_measurements import oracle_drive, starts

AXES = {"x": "x [m]", "y": "y [m]", "v": "v [m/s]"}
RATES = {"success": "success rate", "collision": "collision rate", "lateral": "Δy [m]"}
FRONTS = {Front.CONSTANT_SPEED: "vehicle 1 at constant speed", Front.POLICY: "vehicle 1 driven by the policy"}
SHORT = {"ngsim_car_following": "ngsim", "ngsim_lane_changing": "ngsim_lanes"}
VEHICLE = (4.5, 1.8)  # [m], length and width of the rectangles


def draw(jobs: Sequence[Job], cache: Path, scenes_folder: Path, curves: pd.DataFrame, out: Path) -> list[Path]:
    """Draw all figures of the jobs' scenarios for which there are results. Returns the files."""
    files = []
    with plt.rc_context(STYLE):
        for scenario in scenarios_of(jobs):
            mine = [job for job in jobs if job.scenario.name == scenario.name and job.site is None]
            figures = _synthetic_figures if scenario.recorded is None else _recorded_figures
            for name, figure in figures(scenario, mine, cache, scenes_folder, curves):
                files += save(figure, out, name)
    return files


def _synthetic_figures(
    scenario: Scenario, jobs: Sequence[Job], cache: Path, scenes_folder: Path, curves: pd.DataFrame
) -> Iterator[tuple[str, Figure]]:
    yield f"f4_edge_frequencies_{scenario.name}", edge_frequencies(scenario, jobs, cache)
    if scenario.name.endswith("_mixed"):
        return
    name = "f9_out_of_distribution" if "y" in scenario.features else "f8_success"
    yield from success_figures(f"{name}_{scenario.name}", scenario, curves[curves["scenario"] == scenario.name])
    yield f"f12_example_{scenario.name}", example(scenario, jobs, cache)
    rows = dict.fromkeys(job.row.name for job in jobs)
    for k, shown in enumerate(panels(list(rows), ["GRI"])):
        yield f"f13_std_along_horizon_{scenario.name}{_part(k)}", std_along_horizon(scenario, jobs, cache, shown)
    if gri := _first(jobs, "GRI"):
        yield f"f14_density_{scenario.name}", densities(gri, cache, scenes_folder)
    if ablation := _first(jobs, "GRI-VAIRL"):
        yield f"f15_graph_gri_vairl_{scenario.name}", edge_frequencies(scenario, [ablation], cache)


def _recorded_figures(
    scenario: Scenario, jobs: Sequence[Job], cache: Path, _: Path, curves: pd.DataFrame
) -> Iterator[tuple[str, Figure]]:
    inferring = [job for job in jobs if job.result(cache)["graphs"]]
    if inferring:
        yield f"f6_edge_frequencies_{SHORT[scenario.name]}", edge_frequencies(scenario, inferring, cache)
    lanes = scenario.cross_validation is not None
    points = curves[curves["stage"] == STAGES[0]] if lanes else curves[curves["trained_on"] == "both"]
    yield from success_figures(f"{'f11' if lanes else 'f10'}_success_{SHORT[scenario.name]}", scenario, rates(points))


def success_figures(name: str, scenario: Scenario, curves: pd.DataFrame) -> Iterator[tuple[str, Figure]]:
    """F8 to F11: the success curves of all rows with points, a few rows per figure; GRI and the oracle are in each."""
    rows = [row for row in ("oracle", *(row.name for row in scenario.rows)) if (curves["row"] == row).any()]
    for k, shown in enumerate(panels(rows, ["oracle", "GRI"])):
        yield f"{name}{_part(k)}", success_curves(scenario, curves, shown)


def _part(k: int) -> str:
    """Suffix of the k-th of several figures that show the same for different rows."""
    return f"_{k + 1}" if k else ""


def _first(jobs: Sequence[Job], row: str) -> Job | None:
    return next((job for job in jobs if job.row.name == row), None)


def edge_frequencies(scenario: Scenario, jobs: Sequence[Job], cache: Path) -> Figure:
    """F4, F6: one matrix per edge type and row, mean over seeds. A[i, j] is how often edge j -> i has the type.

    Synthetic scenarios also have the true frequencies. Of recorded lane changes, windows under H1 and under H2 are
    separate, and models are shown before they are fine-tuned.
    """
    found: dict[str, list[np.ndarray]] = {} if scenario.recorded else {"truth": [_true_frequency(jobs[0])]}
    for job in jobs:
        for name, matrices in _frequencies(job, job.result(cache)).items():
            found.setdefault(name, []).append(matrices)
    means = {name: np.mean(seeds, 0) for name, seeds in found.items()}
    return frequency_matrices(means, jobs[0].model.vocabulary, f"{scenario.title}: share of test scenes with the type")


def _frequencies(job: Job, result: dict[str, Any]) -> dict[str, np.ndarray]:
    """[K, N, N] by title."""
    if not result["graphs"]:
        return {}
    if job.scenario.cross_validation is None:
        return {job.row.name: np.array(result["graphs"]["frequency"])}
    inferred, hypothesis = torch.tensor(result["before"]["inferred"]), torch.tensor(result["hypothesis"])
    return {
        f"{job.row.name}, {name}": edge_frequency(inferred[hypothesis == number], len(job.model.vocabulary)).numpy()
        for number, name in enumerate(("H1", "H2"))
    }


def _true_frequency(job: Job) -> np.ndarray:
    """[K, N, N]"""
    shares, vocabulary = job.training.data.shares, job.model.vocabulary
    weights = torch.tensor([float(share.share) for share in shares])
    graphs = [{(edge.sender, edge.receiver): edge.type for edge in share.edges} for share in shares]
    parts = [edge_frequency(InteractionGraph.of_edges(graph, vocabulary).map, len(vocabulary)) for graph in graphs]
    return torch.einsum("g,gkij->kij", weights / weights.sum(), torch.stack(parts)).numpy()


def success_curves(scenario: Scenario, curves: pd.DataFrame, rows: Sequence[str]) -> Figure:
    """Rates of some rows against the starting headway or its ratio δ, mean over seeds, with 95 % bands.

    Bands of synthetic scenes are over all seeds together, those of recorded scenes over the scenes of one seed.
    """
    lanes, synthetic = "y" in scenario.features, scenario.recorded is None
    shown = ["success", *["collision"] * lanes, *["lateral"] * (lanes and synthetic)]
    fronts = list(Front) if synthetic else [None]
    size = (4.5 * len(fronts), 2.6 * len(shown) + 0.9)
    figure, axes = plt.subplots(len(shown), len(fronts), figsize=size, sharex=True, sharey="row", squeeze=False)
    for panels_of_rate, rate in zip(axes, shown, strict=True):
        for axis, front in zip(panels_of_rate, fronts, strict=True):
            points = curves if front is None else curves[curves["front"] == front]
            for name, style in styles(rows).items():
                grouped = points[points["row"] == name].groupby("headway" if synthetic else "ratio")
                mean, scenes = grouped[rate].mean(), None if synthetic else grouped["scenes"].first()
                if scenes is not None:
                    half_width = [pooled_rate(m, n).half_width for m, n in zip(mean, scenes, strict=True)]
                else:
                    half_width = grouped[f"{rate}_half_width"].mean() / np.sqrt(grouped.size())
                if len(mean):
                    curve(axis, name, style, mean.index, mean, half_width)
            if rate != "lateral":
                axis.set_ylim(-0.03, 1.03)
            axis.set_ylabel(RATES[rate])
            axis.set_title(FRONTS[front] if front and rate == "success" else "", fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("starting headway Δx [m]" if synthetic else "δ: share by which the starting headway is shrunk")
    if synthetic:
        axes[0][0].invert_xaxis()  # the axes share it; the test gets harder to the right
    legend_below(figure, axes[0][0], columns=5, height=0.5)
    return figure


def std_along_horizon(scenario: Scenario, jobs: Sequence[Job], cache: Path, rows: Sequence[str]) -> Figure:
    """F13: how far sampled actions of some rows spread the states."""
    figure, axes = plt.subplots(1, len(scenario.features), figsize=(3.3 * len(scenario.features) + 0.4, 3.4))
    for name, style in styles(rows).items():
        results = [job.result(cache)["std"]["along"] for job in jobs if job.row.name == name]
        for axis, feature in zip(axes, scenario.features, strict=True):
            std = np.mean([result[feature] for result in results], 0)
            time = np.arange(len(std)) * jobs[0].training.data.scene_range.dt
            positive = std > 0  # all roll-outs have the same first states
            axis.plot(time[positive], std[positive], label=name, **line(style, int(positive.sum())))
    for axis, feature in zip(axes, scenario.features, strict=True):
        axis.set_xlabel("time [s]")
        axis.set_ylabel(f"standard deviation of {AXES[feature]}")
        axis.set_yscale("log")  # the rows are two orders of magnitude apart
    legend_below(figure, axes[0], columns=4, height=0.544)
    return figure


def densities(job: Job, cache: Path, scenes_folder: Path, samples: int = 400) -> Figure:
    """F14: kernel density of sampled roll-outs of one test scene, vehicles 1 and 0; the scene itself in blue."""
    scene = scenes_of(job.training.data, scenes_folder).test[:1]
    model = checkpoint.load(job.folder(cache) / "model.safetensors")
    sigma = torch.tensor(job.result(cache)["std"]["sigma"])
    states = diagnostics.sampled_states(model, scene, sigma, samples)[:, 0]
    feature = "y" if "y" in job.scenario.features else "v"
    columns = [model.dynamics.index("x"), model.dynamics.index(feature)]
    figure, axes = plt.subplots(2, 1, figsize=(5.0, 5.2), sharex=True)
    share = torch.linspace(0, 1, 9)[:-1, None, None, None]  # points between steps, which the density would show
    for axis, vehicle in zip(axes, (1, 0), strict=True):
        points = states[:, vehicle][..., columns]
        points = (1 - share) * points[:, :-1] + share * points[:, 1:]
        density(axis, points.reshape(-1, 2).numpy())
        recorded = scene.state[0, vehicle][:, columns].numpy()
        axis.plot(recorded[:, 0], recorded[:, 1], color="blue", lw=1.2, label="recorded")
        axis.set_ylabel(AXES[feature])
        axis.set_title(f"vehicle {vehicle} (colour: square root of the density)", fontsize=9)
        axis.autoscale()
    axes[0].legend(frameon=False)
    axes[-1].set_xlabel(AXES["x"])
    figure.tight_layout()
    return figure


def example(scenario: Scenario, jobs: Sequence[Job], cache: Path) -> Figure:
    """F12: one out-of-distribution start as sequences of rectangles: oracle, GRI, Supervised and NRI."""
    headway = scenario.protocol.headways[(5 * len(scenario.protocol.headways)) // 6]
    drives = {"oracle": oracle_drive(jobs[0])}
    drives |= {name: _model_drive(job, cache) for name in ("GRI", "Supervised", "NRI") if (job := _first(jobs, name))}
    start = ood.at_headway(starts(jobs[0]), headway)[:1]
    figure, axes = plt.subplots(len(drives), 1, figsize=(8.0, 1.5 * len(drives) + 0.5), sharex=True, squeeze=False)
    for axis, (name, drive) in zip(axes[:, 0], drives.items(), strict=True):
        state = drive(start, Front.CONSTANT_SPEED)[0]
        _rectangles(axis, state - start[0, 1] * torch.eye(state.shape[-1])[0], "y" in scenario.features)
        axis.set_title(
            f"{name}: final headway {float(state[1, -1, 0] - state[0, -1, 0]):.1f} m", fontsize=8, loc="left"
        )
    axes[-1, 0].set_xlabel("x [m] from the start of vehicle 1 (front)")
    title = f"start at Δx = {headway:+.0f} m; blue: vehicle 0, grey: vehicle 1, darker with time"
    figure.suptitle(title, fontsize=9)
    figure.tight_layout()
    return figure


def _model_drive(job: Job, cache: Path) -> ood.Drive:
    types = torch.tensor(job.result(cache)["ood_types"])
    return ood.drive_by_policy(
        checkpoint.load(job.folder(cache) / "model.safetensors"), types, job.training.data.scene_range.steps
    )


def _rectangles(axis: Axes, state: Tensor, across: bool) -> None:
    """Draw both vehicles every 0.8 s. In one dimension each has a line of its own, so that they can pass."""
    steps = range(0, state.shape[1], 4)
    for vehicle, colour in ((1, "0.4"), (0, "#0072B2")):
        for t in steps:
            y = float(state[vehicle, t, 1]) if across else (2.4 if vehicle == 1 else 0.0)
            x, strength = float(state[vehicle, t, 0]), 0.15 + 0.75 * t / max(steps)
            corner = (x - VEHICLE[0], y - VEHICLE[1] / 2)
            axis.add_patch(Rectangle(corner, *VEHICLE, facecolor=colour, alpha=strength, edgecolor="black", lw=0.5))
    axis.autoscale_view()
    axis.set_aspect("equal")
    axis.set_ylabel("y [m]" if across else "")
    if not across:
        axis.set_yticks([0.0, 2.4], ["0", "1"])
        axis.set_ylabel("vehicle")
