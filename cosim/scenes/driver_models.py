"""What labels must know about SUMO's car-following models: how often drivers decide, and how precise they are."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from cosim.spec.demand import CarFollowingModel
from cosim.world.snapshot import DriverParameters


@dataclass(frozen=True)
class DriverModel:
    """Facts about one of SUMO's car-following models, with SUMO's default parameters."""

    reaction_time: float = 0.0
    """Longest time [s] for which a driver goes on with what it saw."""
    imprecision: float = 0.0
    """By how much errors of perception may lower the acceleration, as a share of the greatest acceleration."""


DRIVER_MODELS: dict[CarFollowingModel, DriverModel] = {
    "Krauss": DriverModel(),  # its sigma is an imperfection of its own
    "IDM": DriverModel(),
    # `treaction`; the imprecision is measured: at .1, .2 and .4 the rules find 94, 98 and 100 % of the gold labels.
    "EIDM": DriverModel(reaction_time=0.5, imprecision=0.3),
}


def steps_per_decision(reaction_time: float, action_step: float, dt: float) -> int:
    """Simulation steps of `dt` [s] from one decision to the next, at most; at least 1.

    `action_step` [s] is SUMO's `actionStepLength`. EIDM counts its actions: as many as simulation steps fit into its
    reaction time.
    """
    actions = max(math.ceil(reaction_time / dt - 1e-6), 1)
    return actions * max(math.ceil(action_step / dt - 1e-6), 1)


def model_of(driver: DriverParameters, models: Mapping[str, CarFollowingModel]) -> DriverModel:
    """The model of a driver; `models` are by vehicle class, whose name begins the name of the vehicle type."""
    return DRIVER_MODELS[models[driver.kind.rpartition(".")[0]]]


def decision_steps(driver: DriverParameters, model: DriverModel, dt: float) -> dict[str, int]:
    """Simulation steps between two decisions about the leader and about requests, by the column of the effect.

    The lane-change model, which answers requests, has no reaction time.
    """
    return {
        "effect_of_leader": steps_per_decision(model.reaction_time, driver.action_step, dt),
        "effect_of_requests": steps_per_decision(0.0, driver.action_step, dt),
    }


def with_imprecision(driver: DriverParameters, model: DriverModel) -> DriverParameters:
    """The driver, whose imperfection includes errors of perception."""
    return replace(driver, imperfection=max(driver.imperfection, model.imprecision))
