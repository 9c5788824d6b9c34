"""Give a trained car-following model an encoder that was taught who reacts to whom.

Reward and policy stay as they are. The encoder is replaced by a `PairEncoder`. The score of novelty is fitted to the
histories of the scenes that the model was trained on.
"""

import time
from collections.abc import Mapping
from typing import Any

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.graph import FOLLOWING
from gri.errors import InputError
from gri.networks.model import RelationalModel
from gri.networks.pair_encoder import PairEncoder, PairEncoderConfig
from gri.progress import Progress, no_progress
from gri.relations.reaction_scenes import Reactions
from gri.training.relations.teach_encoder import TeachingSettings, teach_encoder


def teach_model(
    model: RelationalModel,
    known: Float[Tensor, "S N T D"],
    settings: TeachingSettings,
    seed: int,
    recorded: Reactions | None = None,
    progress: Progress = no_progress,
) -> tuple[RelationalModel, Mapping[str, Any]]:
    """The model with a taught encoder, and how it was taught, for the provenance.

    Args:
        known: histories of the scenes that the model was trained on.
        recorded: windows of recorded traffic and of strangers, for contrastive teaching besides the drawn scenes.

    Raises:
        InputError: the model does not drive car following.
    """
    if model.config.vocabulary != FOLLOWING:
        kinds = ", ".join(model.config.vocabulary)
        raise InputError(f"got a model with edge types {kinds}, wanted none and follow; teach a car-following model")
    started = time.process_time()
    torch.manual_seed(seed)
    config = msgspec.structs.replace(model.config, encoder=None, pair_encoder=PairEncoderConfig())
    taught = RelationalModel(config)
    taught.decoder.load_state_dict(model.decoder.state_dict())
    assert isinstance(taught.encoder, PairEncoder)
    assert taught.novelty is not None
    teach_encoder(taught.encoder, settings, seed, recorded, progress)
    taught.novelty.fit(known, torch.Generator().manual_seed(seed))
    made = {
        "settings": msgspec.to_builtins(settings),
        "seed": seed,
        "recorded_windows": 0 if recorded is None else len(recorded),
        "cpu_seconds": round(time.process_time() - started),
    }
    return taught.requires_grad_(False).eval(), made
