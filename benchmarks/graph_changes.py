"""How soon a model's graph follows relations of SUMO's drivers that begin and end, with and without smoothing.

    python benchmarks/graph_changes.py us101_merge --count 100 --out runs/graph_changes

Scenes of 12 s are cut out of undisturbed traffic, with SUMO's relations of every step (docs/scene-labels.md). The
model infers a graph from the last 5 s every second, as in closed loop. Rows: every inference for itself; smoothing as
in closed loop (docs/decisions/058); smoothing with the switching rate of the labels and the weight of an inference
that gives the best macro-F1, both from other seeds; the constant graph without relations, and the one of
the scene's geometry. Writes the table as CSV.
"""

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from cosim.measures.graph_changes import graph_changes, smoothed_over_time
from cosim.scenes.dataset import DatasetSpec, make
from cosim.scenes.scene_rules import DT, Rules
from cosim.spec.loading import load_scenario, override
from gri import checkpoint
from gri.commands.models import trained_with
from gri.data.scene_file.reading import read, read_step_edges
from gri.inference.step_relations import by_model
from gri.resources import find_checkpoint

STEPS = 60  # of a scene: 12 s; in longer ones, vehicles leave the net before the scene is cut out
EVERY = 1.0  # [s] between two inferences
RATE = 0.02  # [1/s] of decision 058
WEIGHTS = (0.5, 1.0, 2.0, 3.0, 5.0)


def scenes(name: str, seed: int, count: int, folder: Path) -> Path:
    """The scene file of a scenario and a first seed; made if it is not there."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "scenes.parquet"
    if not path.is_file():
        order = DatasetSpec(
            scenario=override(load_scenario(name), {"seed": seed}),
            source=name,
            kinds=("merge",),
            count=count,
            per_seed=max(count // 4, 1),
            gold=False,
            rules=Rules(merging_steps=STEPS),
        )
        make(order, folder, 1, lambda *_: None)
    return path


def truth_and_inference(path: Path, model_name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, float]:
    """Types [P, T] of the labels and of the geometry, probabilities [P, W, K], first inference and history [s]."""
    model_path = find_checkpoint(model_name)
    model, made = checkpoint.load(model_path), checkpoint.provenance(model_path)
    scene_range = trained_with(model_path, made).data.scene_file_range
    assert scene_range is not None, f"{model_name} is for no scene file"
    found = by_model(model, scene_range, path, EVERY)[0]
    labels = read_step_edges(path, "merge", model.config.vocabulary, None)
    hypothesis = read(path, "merge", model.dynamics, model.config.vocabulary, None).hypothesis
    assert hypothesis is not None, "scenes of SUMO have a hypothesis"
    geometry = np.broadcast_to(hypothesis.numpy()[..., None], labels.shape)
    probs = np.moveaxis(found.probs, 1, 2)  # Shape: (scene, pair, inference, type)
    return (
        labels.reshape(-1, labels.shape[-1]),
        geometry.reshape(-1, labels.shape[-1]),
        probs.reshape(-1, *probs.shape[2:]),
        int(found.step[0]) * DT,
        model.history_steps * model.dt,
    )


def held(probs: np.ndarray, steps: int) -> np.ndarray:
    """Types [P, T] between the first inference and the end, each until the next one."""
    return np.repeat(probs.argmax(-1), round(EVERY / DT), axis=1)[:, :steps]


def row(name: str, truth: np.ndarray, types: np.ndarray) -> Mapping[str, object]:
    """One row of the table; delays that were never noticed count as infinite in the median."""
    changes = graph_changes(truth, types, 0, DT)
    return {
        "graph": name,
        "delay of a new edge [s]": np.median(changes.new) if len(changes.new) else np.nan,
        "delay of an ended edge [s]": np.median(changes.ended) if len(changes.ended) else np.nan,
        "new": len(changes.new),
        "ended": len(changes.ended),
        "shown before": changes.anticipated,
        "not noticed": int(np.isinf(np.concatenate([changes.new, changes.ended])).sum()),
        "false switches per 100 pair-seconds": 100 * changes.false_switches,
        "macro-F1": changes.macro_f1,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("scenario", nargs="?", default="us101_merge")
    parser.add_argument("--model", default="us101_merge")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seeds", type=int, nargs=2, default=(31, 51), help="first seeds for tuning and for the table")
    parser.add_argument("--out", type=Path, default=Path("runs/graph_changes"))
    given = parser.parse_args()
    tuning, test = (
        truth_and_inference(scenes(given.scenario, seed, given.count, given.out / f"seed{seed}"), given.model)
        for seed in given.seeds
    )
    labels, _, probs, first, window = tuning
    kinds = probs.shape[-1]
    per_second = (labels[:, 1:] != labels[:, :-1]).mean() / DT
    learned = -np.log(max(1 - per_second * kinds / (kinds - 1), 1e-3))

    def smooth(p: np.ndarray, rate: float, weight: float) -> np.ndarray:
        return smoothed_over_time(p, EVERY, window, rate, weight)

    def score(weight: float, rate: float) -> float:
        true = labels[:, round(first / DT) :]
        return graph_changes(true, held(smooth(probs, rate, weight), true.shape[1]), 0, DT).macro_f1

    best = max(WEIGHTS, key=lambda weight: score(weight, learned))
    labels, geometry, probs, first, _ = test
    true, geometry = labels[:, round(first / DT) :], geometry[:, round(first / DT) :]
    steps = true.shape[1]
    tuned = {weight: held(smooth(probs, learned, weight), steps) for weight in WEIGHTS}
    rows = [
        row("every inference for itself", true, held(probs, steps)),
        row(f"smoothed, {RATE:g} per s (058)", true, held(smooth(probs, RATE, 1.0), steps)),
        *(row(f"smoothed, {learned:.2f} per s, weight {w:g}", true, types) for w, types in tuned.items()),
        row("none at all", true, np.zeros_like(true)),
        row("the geometry of the scene", true, geometry),
    ]
    table = pd.DataFrame(rows)
    print(
        f"{len(true)} pairs of {steps * DT:g} s; {learned:.3f} changes per second; best weight on other seeds: {best:g}"
    )
    print(table.round(2).to_string(index=False))
    table.to_csv(given.out / "graph_changes.csv", index=False)


if __name__ == "__main__":
    main()
