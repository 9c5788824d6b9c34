"""The Supervised baseline: the policy decoder alone, with the true graph as input (Sec. VI-A)."""

import msgspec
import torch

from gri.core.scenes import Scenes
from gri.networks.model import RelationalModel
from gri.networks.rollout import rollout
from gri.progress import Progress, no_progress
from gri.training.optimisation import Descent, action_error, draw_batch, reconstruction_loss
from gri.training.training_state import TrainingState, no_state


class SupervisedSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="supervised"):
    """Settings of the Supervised baseline, which minimises the mean squared error of roll-outs."""

    updates: int = 1500
    batch: int = 64
    learning_rate: float = 3e-3
    action_weight: float = 0.0
    """Weight of the squared error of actions, in units of the scale, relative to that of states [m²]."""


def train_supervised(
    model: RelationalModel,
    scenes: Scenes,
    settings: SupervisedSettings,
    seed: int,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> None:
    """Train the model's decoder in place, under the true graphs of the scenes."""
    generator = torch.Generator().manual_seed(seed)
    descent = Descent(model.decoder.parameters(), settings.learning_rate, settings.updates)
    types = len(model.config.vocabulary)
    for update in (state or no_state()).updates("policy", settings.updates, generator, descent):
        batch = scenes[draw_batch(len(scenes), settings.batch, generator)]
        driven = rollout(model, batch.start, batch.one_hot(types), batch.leader)
        loss = reconstruction_loss(driven.state, batch.state, model.dynamics)
        if settings.action_weight:
            loss = loss + settings.action_weight * action_error(driven.action, batch.action, model.decoder.action_unit)
        descent.step(loss)
        progress("policy", update + 1, settings.updates, float(loss.detach()))
