"""Test sets made of SUMO's drivers: files of triples by `cosim scenes --kind triple --gold`, whose relations are known.

The true graph of a scene says whom each vehicle follows at more than half of the steps. The relations of single steps
stand beside it. Rows see positions and speeds along the road, no lanes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from gri.bench.car_following_scenes import LENGTH, OWN, WINDOW, KnownScenes
from gri.bench.scores import Score
from gri.core.dynamics import POINT_MASS_1D
from gri.core.edges import FOLLOWING, EdgeType, pairs
from gri.data.recorded import with_vehicle_length
from gri.data.scene_file.reading import read, read_lateral, read_step_edges
from gri.data.scene_file.schema import header_of
from gri.errors import InputError

KIND = "triple"
PARTS = ("train", "validation", "test")
SAME_LANE = 2.0  # [m] of lateral distance
RESAMPLES = 300
AHEAD = [edge for edge, (i, j) in enumerate(pairs(3)) if i > j]


@dataclass(frozen=True)
class SumoScenes:
    """S triples with the relations that interventions found; F pairs have their sender ahead."""

    known: KnownScenes
    steps: Bool[np.ndarray, "S F T"]
    """Whether the receiver follows the sender at each step."""
    same_lane: Bool[np.ndarray, "S F"]
    """Whether both vehicles of a pair drive in one lane."""

    @property
    def truth(self) -> Bool[np.ndarray, "S F"]:
        return self.known.graph().numpy()[:, AHEAD] > 0

    @property
    def unambiguous(self) -> Bool[np.ndarray, " S"]:
        """Whether the relation of every pair is the same at all steps."""
        return (self.steps == self.steps[..., :1]).all((1, 2))

    def __getitem__(self, scenes: Bool[np.ndarray, " S"] | Int[np.ndarray, " chosen"]) -> "SumoScenes":
        """The selected scenes."""
        rows = torch.from_numpy(scenes)
        known = KnownScenes(self.known.state[rows], self.known.leader[rows], self.known.acceptance, self.known.shown)
        return SumoScenes(known, self.steps[scenes], self.same_lane[scenes])


@dataclass(frozen=True)
class SumoFile:
    """A scene file: its car-following model, its scenario, and the scenes of each split."""

    drivers: str
    scenario: str
    parts: dict[str, SumoScenes]
    provenance: dict[str, Any]


def read_sumo_file(path: Path) -> SumoFile:
    """Read the triples of a scene file.

    Errors: `InputError` if the file has no triples with gold labels in every split, or too few steps.
    """
    provenance = header_of(path).provenance.get("sumo", {})
    if not provenance.get("gold") or KIND not in provenance.get("kinds", ()):
        raise InputError(
            f"{path}: got a file without labels by intervention of triples; make one with"
            " `cosim scenes us101_car_following --kind triple --gold --reduction longest --out …`"
        )
    models = {vehicles["car_following"] for vehicles in provenance["scenario"]["traffic"]["vehicles"]}
    parts = {part: _read_part(path, part) for part in PARTS}
    return SumoFile(" and ".join(sorted(models)), provenance["source"], parts, provenance)


def _read_part(path: Path, part: str) -> SumoScenes:
    found = read(path, KIND, POINT_MASS_1D, FOLLOWING, part)
    if found.trajectory.state.shape[2] != WINDOW:
        raise InputError(
            f"{path}: got triples of {found.trajectory.state.shape[2]} steps, wanted {WINDOW}; make the file again"
        )
    state = with_vehicle_length(LENGTH, found.trajectory.state, found.length).double()
    state[..., 0] -= state[:, :1, :1, 0].clone()
    steps = read_step_edges(path, KIND, FOLLOWING, part) == FOLLOWING.index(EdgeType.FOLLOW)
    y = read_lateral(path, KIND, part)
    senders, receivers = (np.array([pair[end] for pair in pairs(3)])[AHEAD] for end in (0, 1))
    same_lane = np.abs(y[:, senders, 0] - y[:, receivers, 0]) < SAME_LANE
    known = KnownScenes(state, torch.from_numpy(_leaders(steps)), 1.0)
    return SumoScenes(known, steps[:, AHEAD], same_lane)


def _leaders(steps: Bool[np.ndarray, "S E T"]) -> Int[np.ndarray, "S N"]:
    """Whom each vehicle follows at more than half of the steps; `OWN` where it is none of the scene."""
    leader = np.full((len(steps), 3), OWN)
    for edge, (i, j) in enumerate(pairs(3)):
        leader[steps[:, edge].mean(1) > 0.5, j] = i
    return leader


def joined(scenes: Sequence[SumoScenes]) -> SumoScenes:
    """All scenes, in order."""
    state = torch.cat([of.known.state for of in scenes])
    known = KnownScenes(state, torch.cat([of.known.leader for of in scenes]), 1.0)
    return SumoScenes(
        known, np.concatenate([of.steps for of in scenes]), np.concatenate([of.same_lane for of in scenes])
    )


def best_constant(truth: Bool[np.ndarray, "S F"]) -> float:
    """Greatest share of right pairs among all constant graphs."""
    graphs = np.array(list(product((False, True), repeat=truth.shape[1])))
    return float(max((truth == graph).mean() for graph in graphs))


def lengthened(p: Float[np.ndarray, "S F"], steps: Bool[np.ndarray, "S F T"]) -> tuple[np.ndarray, np.ndarray]:
    """One answer per scene and the truth of every step, both as [S, F · T]."""
    return np.repeat(p, steps.shape[-1], 1), steps.reshape(len(steps), -1)


def matched_auc(
    p: Float[np.ndarray, "S F"],
    truth: Bool[np.ndarray, "S F"],
    time_gap: Float[np.ndarray, "S F"],
    speed_difference: Float[np.ndarray, "S F"],
) -> float:
    """AUC between true and missing edges of equal geometry; ties count half, NaN without such couples.

    A couple counts if its time gaps [s] differ by less than 15 % and its speed differences by less than 0.5 m/s, both
    in the last frame. So a row that looks at the last frame of single pairs has 0.5.
    """
    gap, difference = np.log(time_gap), speed_difference
    near = (np.abs(gap[truth][:, None] - gap[~truth]) < 0.15) & (
        np.abs(difference[truth][:, None] - difference[~truth]) < 0.5
    )
    if not near.any():
        return float("nan")
    over = p[truth][:, None] - p[~truth]
    return float(((over > 0) + 0.5 * (over == 0))[near].mean())


def matched_auc_score(p: Float[np.ndarray, "S F"], scenes: SumoScenes) -> Score:
    """`matched_auc` with its 95 % interval over scenes (percentile bootstrap)."""
    x, v = (scenes.known.state[:, :, WINDOW - 1, k].numpy() for k in (0, 1))
    senders, receivers = (np.array([pair[end] for pair in pairs(3)])[AHEAD] for end in (0, 1))
    time_gap = (x[:, senders] - x[:, receivers] - LENGTH).clip(0.5) / (v[:, receivers] + 1.0)
    values = p, scenes.truth, time_gap, v[:, senders] - v[:, receivers]
    draws = np.random.default_rng(0).integers(len(p), size=(RESAMPLES, len(p)))
    found = [matched_auc(*(of[rows] for of in values)) for rows in draws]
    low, high = (float("nan"), float("nan")) if np.isnan(found).all() else np.nanquantile(found, (0.025, 0.975))
    return Score(matched_auc(*values), float(low), float(high))
