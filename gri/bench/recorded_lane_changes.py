"""Recorded lane changes: agreement with the paper's hypothesis, and vehicle 0 kept in its lane as a control.

Vehicles 1 and 2 keep their lane; vehicle 0 changes into it. If vehicle 0 is kept in its lane, nobody yields to it and
it yields to nobody: each "yield" is wrong. No row is given which edges are possible, but for the prior, which is a row.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from gri import checkpoint
from gri.bench.recorded_scores import share
from gri.core.dynamics import dynamics_named
from gri.core.edges import EdgeType
from gri.core.scenes import Scenes
from gri.data.ngsim.extract import HYPOTHESES, extract
from gri.data.ngsim.rules import Rules
from gri.data.ranges.recorded import NGSIM_LANE_CHANGING
from gri.data.recorded import recorded_scenes, scenes_to_test
from gri.errors import InputError
from gri.planning.edge_posterior import edge_prior, marginals
from gri.planning.riccati_likelihood import expand_steps, log_likelihood_by_steps
from gri.storage.scratch import ScratchFolder
from gri.training.grounded.recorded_traffic import RecordedSettings, recorded_prior
from gri.training.grounded.settings import GroundedSettings

MODEL = "ngsim_lane_changing"
FLAT = 0.9  # prior probability of "none", of every edge; the other types share the rest
ALLOWING = 0.3  # the same, so small that a possible type is more probable than "none"
UPDATES = 800
Types = Callable[[Scenes], Int[Tensor, "S E"]]


def lane_change_scores(files: Sequence[Path]) -> pd.DataFrame:
    """Agreement and false yields of every row; an empty table where the files have no lane changes to test.

    Columns: row, given, score, value, low, high, windows. Intervals are clustered by vehicle 0.

    Errors: `InputError` if a file cannot be read.
    """
    with ScratchFolder() as folder:
        path = Path(folder) / "scenes.parquet"
        try:
            extract(files, path, Rules(), tuple(HYPOTHESES))
            train, _ = recorded_scenes(path, NGSIM_LANE_CHANGING, "train")
            tested, found, _ = scenes_to_test(path, NGSIM_LANE_CHANGING, "test")
        except InputError as error:
            if "no scene" in str(error) or "has no" in str(error):
                return pd.DataFrame()
            raise
    lines: list[dict[str, Any]] = []
    kept, cluster = kept_in_lane(tested), np.asarray(found.vehicle)[:, 0]
    yields = NGSIM_LANE_CHANGING.vocabulary.index(EdgeType.YIELD)
    wanted = tested.graph.numpy()
    every = np.ones(wanted.shape, bool)
    for name, given, prepare in ROWS:
        infer = prepare(train)
        scores = {
            "agreement": share(infer(tested).numpy() == wanted, every, cluster),
            "edges found": share(infer(tested).numpy() == wanted, wanted > 0, cluster),
            "kept in lane: false yield": share(infer(kept).numpy() == yields, wanted == yields, cluster),
        }
        lines += [
            {"row": name, "given": given, "score": score, **asdict(value), "windows": len(tested)}
            for score, value in scores.items()
        ]
    return pd.DataFrame(lines)


def kept_in_lane(scenes: Scenes) -> Scenes:
    """The scenes with vehicle 0 at its first lateral position all along; its motion along the road stays."""
    dynamics = dynamics_named(NGSIM_LANE_CHANGING.dynamics)
    state = scenes.state.clone()
    state[:, 0, :, dynamics.state.index("y")] = state[:, 0, :1, dynamics.state.index("y")]
    for name in ("vy", "ay"):
        state[:, 0, :, dynamics.state.index(name)] = 0.0
    action = dynamics.inverse(state[:, :-1, :-1], state[:, :-1, 1:], NGSIM_LANE_CHANGING.dt)
    return replace(scenes, state=state, action=action)


def _constant(train: Scenes) -> Types:
    """The most frequent type of each edge in the scenes for teaching."""
    graph = train.graph.mode(0).values
    return lambda scenes: graph.expand(len(scenes), -1)


def _prior(train: Scenes) -> Types:
    """Every edge that the prior of training allows, which knows lanes and who is ahead; no motion."""
    del train
    reward = checkpoint.load_reward(MODEL)
    assert reward is not None
    return lambda scenes: recorded_prior(
        reward, scenes.state, RecordedSettings(grounded=GroundedSettings(ahead_only=True, no_edge_prior=ALLOWING))
    ).argmax(-1)


def _last_frame(train: Scenes) -> Types:
    """A classifier of every edge that sees where vehicles are in the last frame."""
    torch.manual_seed(0)

    def see(scenes: Scenes) -> Float[Tensor, "S F"]:
        place = scenes.state[:, :, -1, :2]
        return ((place - place[:, -1:]) / torch.tensor([20.0, 4.0])).flatten(1)

    edges, types = train.graph.shape[1], len(NGSIM_LANE_CHANGING.vocabulary)
    model = nn.Sequential(nn.Linear(see(train).shape[1], 32), nn.SiLU(), nn.Linear(32, edges * types))
    optimiser = torch.optim.Adam(model.parameters(), 3e-3)
    for _ in range(UPDATES):
        rows = torch.randint(len(train), (128,))
        logits = model(see(train[rows])).reshape(-1, types)
        loss = nn.functional.cross_entropy(logits, train.graph[rows].flatten())
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return lambda scenes: model(see(scenes)).reshape(-1, edges, types).argmax(-1)


def _encoder(train: Scenes) -> Types:
    del train
    model = checkpoint.load(MODEL)
    return lambda scenes: model.infer(scenes.observed).probs.argmax(-1)


def _flat_posterior(train: Scenes) -> Types:
    """The posterior under the released reward, with the same prior for every edge."""
    del train
    model, reward = checkpoint.load(MODEL), checkpoint.load_reward(MODEL)
    assert reward is not None

    @torch.no_grad()
    def infer(scenes: Scenes) -> Int[Tensor, "S E"]:
        expansion = expand_steps(model, reward, scenes.state, scenes.action, False)
        likelihood = log_likelihood_by_steps(reward, expansion.double()).to(scenes.state.dtype)
        prior = edge_prior(len(reward.vocabulary), FLAT).repeat(len(scenes), scenes.graph.shape[1], 1)
        return marginals(reward, likelihood, prior).argmax(-1)

    return infer


ROWS: tuple[tuple[str, str, Callable[[Scenes], Types]], ...] = (
    ("most frequent type of each edge", "hypothesis of training scenes", _constant),
    ("every edge that the prior allows", "lanes, who is ahead", _prior),
    ("geometry of the last frame", "hypothesis of training scenes", _last_frame),
    (f"released: {MODEL}", "no labels; trained with that prior", _encoder),
    ("posterior of its reward, flat prior", "no labels", _flat_posterior),
)
