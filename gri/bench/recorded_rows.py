"""The rows for recorded traffic: rows of the simulated benchmark, and rows that learn from the recordings.

Nobody labelled the recordings. Rows that are "taught with strangers" see windows in which each vehicle follows the next
by hypothesis, and windows that were broken on purpose.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from gri.bench.answers import Infer, Score, observed
from gri.bench.car_following_scenes import DT, KnownScenes
from gri.bench.driver_models import DRIVER_MODELS
from gri.bench.families import NEAR, WIDE, split
from gri.bench.learned_driver import learn_driver
from gri.bench.pair_classifier import train_classifier
from gri.bench.recorded_sets import Recordings, as_scenes, balanced
from gri.bench.rows import (
    MOST_LAG,
    ROWS,
    Row,
    closed_form,
    granger,
    lagged_correlation,
    with_threshold,
)
from gri.bench.speed_gaussian import fit_gaussians
from gri.core.edges import pairs
from gri.networks.pair_encoder import PairEncoder
from gri.training.relations.recorded_windows import ContrastSettings, contrast_windows
from gri.training.relations.teach_recorded import teach_recorded_encoder

UPDATES, BATCH = 400, 64  # of the taught networks
TAUGHT_KINDS = (
    "recorded",
    "strangers",
    "different lanes",
    "one between, in the next lane",
    "headway x 4",
    "headway x 15",
    "headway + 60 m",
    "headway + 150 to 300 m",
    "free flow, headway added",
    "free flow, recorded",
)
"""What the contrastive network is taught; all other controls are unknown to it."""
SIMULATED = ("nobody follows", "everybody follows the next", "prior alone", "untrained encoder")
RELEASED = tuple(
    f"released: {name}"
    for name in ("us101_car_following", "ngsim_car_following", "ngsim_relations", "sumo_car_following")
)

ANEW = "ngsim_relations, taught anew in each fold"


@dataclass(frozen=True)
class RecordedRow:
    """A way to infer relations in recorded traffic."""

    name: str
    given: str
    prepare: Callable[[Recordings, str, int, int], Infer]
    """(recordings, window, fold, seed) → how to infer."""
    varies: bool = False
    """Whether the seed changes the answer."""
    taught: bool = True
    """Whether it is made anew for each fold and window."""
    test_part_only: bool = False
    """Whether only the test part is scored: it was trained on other vehicles, or it is slow to train five times."""


def speed_correlation(scenes: KnownScenes) -> Float[Tensor, "S E"]:
    """Greatest correlation of the sender's speed with the receiver's up to 2 s later."""
    v = observed(scenes)[..., 1]
    found = []
    for i, j in pairs(v.shape[1]):
        values = []
        for lag in range(MOST_LAG + 1):
            cause, effect = v[:, i, : v.shape[-1] - lag], v[:, j, lag:]
            cause, effect = (part - part.mean(-1, keepdim=True) for part in (cause, effect))
            norm = (cause.square().sum(-1) * effect.square().sum(-1)).sqrt().clamp(min=1e-9)
            values.append((cause * effect).sum(-1) / norm)
        found.append(torch.stack(values).amax(0))
    return torch.stack(found, 1)


@cache
def _simulated(part: str, count: int) -> tuple[KnownScenes, ...]:
    return tuple(split(part, model, family, count) for family in (NEAR, WIDE) for model in DRIVER_MODELS)


def from_simulation(row: Row, test_part_only: bool = False) -> RecordedRow:
    """A row of the simulated benchmark, prepared there, as it is."""

    @cache
    def prepared(seed: int) -> Infer:
        return row.prepare(_simulated("train", 1500), _simulated("validation", 300), seed)

    given = {"labels": "labels of simulated drivers"}.get(row.given, row.given)
    return RecordedRow(row.name, given, lambda _, __, ___, seed: prepared(seed), row.varies, False, test_part_only)


def _contrast(recordings: Recordings, window: str, fold: int) -> list[KnownScenes]:
    """Recorded pairs and strangers of the training part."""
    return [as_scenes(balanced(recordings.training(window, "pairs", fold, ("recorded", "strangers"))))]


def _scored(score: Score) -> Callable[[Recordings, str, int, int], Infer]:
    return lambda recordings, window, fold, seed: with_threshold(score)((), _contrast(recordings, window, fold), seed)


def _gaussian(recordings: Recordings, window: str, fold: int, seed: int) -> Infer:
    windows = recordings.training(window, "pairs", fold, ("recorded", "strangers"))
    return with_threshold(fit_gaussians(windows))((), _contrast(recordings, window, fold), seed)


def _learned_driver(recordings: Recordings, window: str, fold: int, seed: int) -> Infer:
    windows = recordings.training(window, "pairs", fold, ("recorded",))
    return with_threshold(learn_driver(windows, seed))((), _contrast(recordings, window, fold), seed)


def _closed_form(recordings: Recordings, window: str, fold: int, seed: int) -> Infer:
    """Weights of the explanations from the recorded training part, half of it strangers."""
    windows = balanced(recordings.training(window, "triples", fold, ("recorded", "strangers")))
    chosen = torch.randperm(len(windows), generator=torch.Generator().manual_seed(seed))[:400]
    return closed_form((as_scenes(windows[chosen]),), (), seed)


def _last_frame(recordings: Recordings, window: str, fold: int, seed: int) -> Infer:
    return train_classifier(_contrast(recordings, window, fold), lambda state: state[:, :, -1:], seed, UPDATES, BATCH)


def _contrastive_pairs(recordings: Recordings, window: str, fold: int, seed: int) -> Infer:
    return train_classifier(_contrast(recordings, window, fold), lambda state: state, seed, UPDATES, BATCH)


def _contrastive_all(recordings: Recordings, window: str, fold: int, seed: int) -> Infer:
    windows = balanced(recordings.training(window, "triples", fold, TAUGHT_KINDS))
    return train_classifier([as_scenes(windows)], lambda state: state, seed, UPDATES, BATCH)


def _as_released(recordings: Recordings, window: str, fold: int, seed: int) -> Infer:
    """An encoder that is taught as that of `ngsim_relations`, on the training part of a fold; one for all windows."""
    del window
    key = "ngsim_relations", fold, seed
    if key not in recordings.taught:
        recordings.taught[key] = _taught_encoder(recordings, fold, seed)
    encoder = recordings.taught[key]

    @torch.no_grad()
    def infer(scenes: KnownScenes) -> Float[Tensor, "S E"]:
        p = encoder.explanations(observed(scenes)[..., :2].float())[..., 2:].double()
        return torch.stack([p[:, j, i] for i, j in pairs(p.shape[1])], 1)

    return infer


def _taught_encoder(recordings: Recordings, fold: int, seed: int) -> PairEncoder:
    settings = ContrastSettings()
    encoder = PairEncoder(settings.encoder, speed=1, dt=DT)
    teach_recorded_encoder(encoder, contrast_windows(recordings.sites, settings, fold=fold), settings, seed)
    return encoder.requires_grad_(False).eval()


def _rows() -> Sequence[RecordedRow]:
    known = {row.name: row for row in ROWS}
    strangers = "recorded pairs and strangers"
    return (
        *(from_simulation(known[name]) for name in SIMULATED),
        RecordedRow("lagged correlation of speeds", f"{strangers} (threshold)", _scored(speed_correlation)),
        RecordedRow("lagged correlation", f"{strangers} (threshold)", _scored(lagged_correlation)),
        RecordedRow("Granger test", f"{strangers} (threshold)", _scored(granger)),
        RecordedRow("geometry of the last frame", strangers, _last_frame, varies=True),
        *(from_simulation(known[name], "ngsim" in name) for name in RELEASED),
        RecordedRow(ANEW, "recorded and broken pairs and triples, 6 and 12 s", _as_released, varies=True),
        from_simulation(known["closed form"]),
        RecordedRow("closed form, weights from recordings", strangers, _closed_form, varies=True),
        from_simulation(known["labelled classifier (ceiling)"]),
        RecordedRow(
            "learned driver, unseen leader as null", f"recorded pairs; {strangers} (threshold)", _learned_driver
        ),
        RecordedRow("joint Gaussian of speeds", strangers, _gaussian),
        RecordedRow(
            "contrastive network, all controls",
            "recorded and broken triples",
            _contrastive_all,
            True,
            test_part_only=True,
        ),
        RecordedRow("contrastive network, pairs (ceiling)", strangers, _contrastive_pairs, varies=True),
    )


RECORDED_ROWS: tuple[RecordedRow, ...] = tuple(_rows())
