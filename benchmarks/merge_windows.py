"""Relations of merges online, in whole scenes and in windows that begin anywhere.

    python benchmarks/merge_windows.py runs/test-i80/scenes.parquet --train runs/teach-us101/scenes.parquet \
        --train runs/teach-i80/scenes.parquet

`cosim scenes` cuts nearly all merges so that the lane change is in the middle. A constant per pair and step then knows
when it happens; in windows that begin anywhere it does not. The rows are scored as they are, and in windows of 26
states that begin at a random step of each scene, from their 10th state on. There the encoder sees the window only; the
other rows see more. Controls are those of `gri bench merges`.
"""

import argparse
from pathlib import Path

import numpy as np
import torch

from gri import checkpoint
from gri.bench.merge_classifier import frame_features, teach
from gri.bench.merge_rows import as_the_models_see
from gri.bench.merge_scenes import PAIRS, MergeScenes, controls, read_merges
from gri.bench.merge_scores import accuracy, calibration_error, claimed, macro_f1, with_interval
from gri.inference.step_relations import released_merge_constants
from gri.networks.encoder import Encoder
from gri.networks.model import RelationalModel
from gri.relations.merge_motion import motion_of
from gri.relations.merge_posterior import relations

LEAST, HISTORY, WINDOW, FIRST = 10, 25, 26, 2  # states; online rows begin at step 2
NOISE = (0.02, 0.1)  # [m] on x; a fifth of it on y, half of it per second on v


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, help="merges to score")
    parser.add_argument(
        "--train", type=Path, action="append", required=True, help="merges of other seeds, for what is taught labels"
    )
    parser.add_argument("--models", default="merge_relations,us101_merge,mixed_merge")
    given = parser.parse_args()
    torch.set_num_threads(1)
    scenes, others = read_merges(given.scenes), [read_merges(path) for path in given.train]
    train = next((part.steps.numpy() for part in others if part.site == scenes.site), None)
    if train is None:
        parser.error(f"--train: none has merges of {scenes.site}")
    truth, seen, constants = scenes.steps.numpy(), as_the_models_see(scenes), released_merge_constants()
    models = {name: checkpoint.load(name) for name in given.models.split(",")}
    models["untrained encoder"] = untrained(models[given.models.split(",")[0]])
    posterior = {
        "posterior, whole scene": relations(scenes.motion(), constants).numpy(),
        "posterior, online": online(scenes),
        "geometry of one frame (labels)": taught_labels(others, scenes, kernel=1),
        "whole scene (labels), the ceiling": taught_labels(others, scenes, kernel=5),
    }
    inferred = {name: by_steps(model, seen) for name, model in models.items()}
    for first in (FIRST, LEAST - 1, HISTORY - 1):
        print(f"\nfrom step {first} on")
        t = truth[:, first:]
        for name, p in posterior.items():
            show(name, p[:, first:], t)
        show("constant per pair and step, these scenes", certain(mode(truth)[first:], t), t)
        show("constant per pair and step, other seeds", certain(mode(train)[first:], t), t)
        for name, p in inferred.items() if first >= LEAST - 1 else ():
            show(name, p[:, first:], t)
    windows(truth, train, posterior, seen, models)
    print("\nnoise, from step 9 on")
    for sd in NOISE:
        first = next(iter(models))
        show(f"{first}, {sd} m", by_steps(models[first], noisy(seen, sd))[:, LEAST - 1 :], truth[:, LEAST - 1 :])
    print("\nshare of steps with a relation that cannot hold")
    for control in controls(scenes):
        impossible = tuple((PAIRS.index(pair), kinds) for pair, kinds in control.impossible)
        counts = np.arange(truth.shape[1]) >= (truth.shape[1] // 2 if control.after_change else LEAST - 1)
        answers = {name: by_steps(model, as_the_models_see(control.scenes)) for name, model in models.items()}
        answers["posterior, whole scene"] = relations(control.scenes.motion(), constants).numpy()
        said = {name: claimed(p.argmax(-1), impossible, counts).mean() for name, p in answers.items()}
        print(f"{control.name}: " + ", ".join(f"{name} {share:.3f}" for name, share in said.items()))


def taught_labels(others: list[MergeScenes], scenes: MergeScenes, kernel: int) -> np.ndarray:
    """A network that is taught the relations of other scenes. It also sees each step's acceleration to the next one."""
    features = torch.cat([frame_features(part) for part in others])
    steps, graph = (torch.cat([getattr(part, name) for part in others]) for name in ("steps", "graph"))
    network = teach(features, steps, graph, kernel, 0)
    with torch.no_grad():
        return network(frame_features(scenes))[0].double().softmax(-1).numpy()


def untrained(model: RelationalModel) -> RelationalModel:
    """The same model with the first weights of its encoder."""
    torch.manual_seed(0)
    blank = RelationalModel(model.config)
    assert isinstance(blank.encoder, Encoder)
    return blank.eval()


def online(scenes: MergeScenes) -> np.ndarray:
    """What the posterior says about each step when it has seen nothing later; zeros before step 2."""
    found = np.zeros((*scenes.steps.shape, 4))
    for t in range(FIRST, scenes.steps.shape[1]):
        motion = motion_of(scenes.state[:, :, : t + 1], scenes.lane_width, scenes.dt, scenes.length, unfinished=True)
        found[:, t] = relations(motion, released_merge_constants(), unfinished=True)[:, -1].numpy()
    return found


@torch.no_grad()
def by_steps(model: RelationalModel, seen: torch.Tensor, first: int = 0) -> np.ndarray:
    """What an encoder says about each step from up to 25 states before it, none before `first`; else zeros."""
    found = np.zeros((len(seen), seen.shape[2], len(PAIRS), 4))
    for t in range(first + LEAST - 1, seen.shape[2]):
        window = seen[:, :, max(first, t + 1 - HISTORY) : t + 1].clone()
        window[..., 0] -= window[:, -1:, -1:, 0]
        found[:, t] = model.infer(window.float()).probs.double().numpy()
    return found


def windows(
    truth: np.ndarray,
    train: np.ndarray,
    posterior: dict[str, np.ndarray],
    seen: torch.Tensor,
    models: dict[str, RelationalModel],
) -> None:
    """Windows of the scenes that begin at a random step, from their 10th state on."""
    rng = np.random.default_rng(0)
    begin = rng.integers(0, truth.shape[1] - WINDOW + 1, len(truth))
    other = rng.integers(0, train.shape[1] - WINDOW + 1, len(train))
    judged = np.arange(LEAST - 1, WINDOW)

    def cut(values: np.ndarray, starts: np.ndarray) -> np.ndarray:
        return np.stack([values[k, s + judged] for k, s in enumerate(starts)])

    t = cut(truth, begin)
    print(f"\nwindows of {WINDOW} states that begin anywhere, from the {LEAST}th state on")
    for name, p in posterior.items():
        show(name, cut(p, begin), t)
    show("constant per pair and step, these windows", certain(mode(t), t), t)
    show("constant per pair and step, other seeds", certain(mode(cut(train, other)), t), t)
    states = torch.stack([seen[k, :, s : s + WINDOW] for k, s in enumerate(begin.tolist())])
    for name, model in models.items():
        show(name, by_steps(model, states)[:, judged], t)


def noisy(seen: torch.Tensor, sd: float) -> torch.Tensor:
    noise = torch.randn(seen[..., :3].shape, generator=torch.Generator().manual_seed(1), dtype=seen.dtype)
    found = seen.clone()
    found[..., :3] += sd * noise * torch.tensor([1.0, 0.2, 0.5], dtype=seen.dtype)
    return found


def mode(truth: np.ndarray) -> np.ndarray:
    """The most frequent relation of each pair and step."""
    return (truth[None] == np.arange(4).reshape(-1, 1, 1, 1)).sum(1).argmax(0)


def certain(answer: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Probabilities of a constant answer for all scenes."""
    return np.eye(4)[np.broadcast_to(answer, like.shape)]


def show(name: str, p: np.ndarray, truth: np.ndarray) -> None:
    answer = p.argmax(-1)
    score = with_interval(macro_f1, answer, truth)
    spread, right, error = f"({score.low:.3f}-{score.high:.3f})", accuracy(answer, truth), calibration_error(p, truth)
    print(f"{name:42s} macro-F1 {score.value:.3f} {spread}  accuracy {right:.3f}  calibration error {error:.3f}")


if __name__ == "__main__":
    main()
