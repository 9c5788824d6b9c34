"""An initial policy for the adversarial objective: near the best response to the initial reward under every graph."""

import msgspec
import torch

from gri.core.scenes import Scenes
from gri.networks.model import RelationalModel
from gri.progress import Progress, no_progress
from gri.rewards.structured import StructuredReward
from gri.training.grounded.augmentation import Shifts
from gri.training.grounded.optimal_scenes import OptimaSettings, distance_to_optima, optimal_scenes
from gri.training.grounded.settings import GroundedSettings
from gri.training.grounded.train_grounded import off_data_batch, plan_policy
from gri.training.optimisation import Descent, draw_batch
from gri.training.training_state import TrainingState, no_state


class PlanSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """First maximise the reward under random graphs, then imitate optimal scenes that start from that policy."""

    updates: int = 500
    """Updates of the maximisation."""
    batch: int = 128
    rate: float = 3e-3
    """Learning rate of both steps."""
    optima: OptimaSettings = OptimaSettings()
    imitation_updates: int = 1200
    imitation_batch: int = 64


def plan_by_imitation(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: PlanSettings,
    generator: torch.Generator,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> None:
    """Train the model's policy in place. The scenes give the starts and the leader only; no demonstration is used."""
    grounded = GroundedSettings(
        planner_updates=settings.updates,
        planner_batch=settings.batch,
        policy_rate=settings.rate,
        shifts=Shifts(position=(0.0, 0.0)),
    )
    plan_policy(model, reward, scenes, grounded, generator, progress, state)
    start, leader, graph = off_data_batch(model, scenes, grounded, settings.optima.scenes, generator)
    optima = optimal_scenes(model, reward, start, leader, graph, settings.optima, progress)
    total = settings.imitation_updates
    descent = Descent(model.decoder.parameters(), settings.rate, total)
    for update in (state or no_state()).updates("plan", total, generator, descent):
        chosen = draw_batch(len(optima), settings.imitation_batch, generator)
        loss = distance_to_optima(model, optima[chosen], grounded.optima_scale)
        descent.step(loss)
        progress("plan", update + 1, total, float(loss.detach()))
