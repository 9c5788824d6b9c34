"""A policy planned on the reward as it stands, before anyone is imitated: near the best response under every graph."""

import msgspec
import torch

from gri.data.synthetic import Scenes
from gri.model import RelationalModel
from gri.objectives.common import Descent, batches
from gri.objectives.gri import GroundedSettings, plan
from gri.objectives.optima import OptimaSettings, distance, optimal_scenes
from gri.objectives.variation import Shifts, elsewhere
from gri.progress import Progress, silent
from gri.rewards import StructuredReward

CONTRADICTION = 0.5
"""Distance [m] from which on it counts linearly only: no policy reaches the optima of contradictory graphs."""


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
    progress: Progress = silent,
) -> None:
    """Train the policy in place. Of the scenes only the starts and the leader are used, no demonstration."""
    still = Shifts(position=(0.0, 0.0))
    climbing = GroundedSettings(
        planner_updates=settings.updates, planner_batch=settings.batch, policy_rate=settings.rate, shifts=still
    )
    plan(model, reward, scenes, climbing, generator, progress)
    types = len(model.config.vocabulary)
    begun = elsewhere(scenes, still, None, model.dynamics, types, settings.optima.scenes, generator)
    optima = optimal_scenes(model, reward, *begun, settings.optima, progress)
    total = settings.imitation_updates
    descent = Descent(model.decoder.parameters(), settings.rate, total)
    for update, chosen in enumerate(batches(len(optima), settings.imitation_batch, total, generator)):
        away = distance(model, optima[chosen], CONTRADICTION)
        descent.step(away)
        progress("plan", update + 1, total, float(away.detach()))
