"""A policy planned on the reward as it stands, before anyone is imitated: near the best response under every graph."""

import msgspec
import torch

from gri.core.scenes import Scenes
from gri.networks.model import RelationalModel
from gri.progress import Progress, no_progress
from gri.rewards.structured import StructuredReward
from gri.training.grounded.augmentation import Shifts
from gri.training.grounded.optimal_scenes import OptimaSettings, distance, optimal_scenes
from gri.training.grounded.settings import GroundedSettings
from gri.training.grounded.train_grounded import off_data_returns, plan
from gri.training.optimisation import Descent, batches


class PlanSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Climbing to the reward under random graphs, then imitating optima that start from there."""

    updates: int = 500
    batch: int = 128
    rate: float = 3e-3
    optima: OptimaSettings = OptimaSettings()
    imitation_updates: int = 1200
    imitation_batch: int = 64


def plan_by_optima(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: PlanSettings,
    generator: torch.Generator,
    progress: Progress = no_progress,
) -> None:
    """Train the policy in place. Of the scenes only the starts and the leader are used, no demonstration."""
    climbing = GroundedSettings(
        planner_updates=settings.updates,
        planner_batch=settings.batch,
        policy_rate=settings.rate,
        shifts=Shifts(position=(0.0, 0.0)),
    )
    plan(model, reward, scenes, climbing, generator, progress)
    begun = off_data_returns(model, scenes, climbing, settings.optima.scenes, generator)
    optima = optimal_scenes(model, reward, *begun, settings.optima, progress)
    total = settings.imitation_updates
    descent = Descent(model.decoder.parameters(), settings.rate, total)
    for update, chosen in enumerate(batches(len(optima), settings.imitation_batch, total, generator)):
        away = distance(model, optima[chosen], climbing.optima_scale)
        descent.step(away)
        progress("plan", update + 1, total, float(away.detach()))
