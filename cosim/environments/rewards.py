"""The reward of a learner: a weighted sum of named terms, per step and for the outcome.

The step terms are those of `gri.rewards.terms` (Sec. VI-C) for the relations that the group rule implies: "jerk" of the
vehicle alone, "follow.lat" of the relation in which it follows its leader, and so on. They are costs, 0 or more. The
outcome terms are 0 or 1, and count in the last step.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from cosim.spec.scenario import GroupRule, Merge
from cosim.world.groups import expected_graph
from gri.errors import InputError
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.lane_changing_features import LaneConstants
from gri.rewards.terms import LaneRewardConfig, RewardConfig, car_following_terms, lane_changing_terms

OUTCOME_TERMS = ("completed", "contact", "not_completed", "order_kept", "off_road", "lane_end")
"""1 if the drive was completed; ended in a contact, until 10 s after the hand-back; was not completed; kept the order
(the paper's success); ended beside the road; ended at the end of the lane."""
CONSTANTS = FollowingConstants(
    standstill=7.02, time_headway=1.29, comfort=1.37, minimum=7.02, zeta=8.0, speed_limit=29.0
)
"""Drivers fitted to the US-101 recordings (`gri.core.policy.IntelligentDriver`), with a vehicle of 5 m in headways."""
DEFAULT_FOR_MERGES = {
    "completed": 2.0,
    "contact": -6.0,
    "off_road": -4.0,
    "follow.lat": -0.003,
    "follow.dist": -0.05,
    "cut_in.dist": -0.05,
    "heading": -0.005,
    "acceleration": -0.001,
}
DEFAULT_FOR_CAR_FOLLOWING = {
    "completed": 1.0,
    "contact": -6.0,
    "follow.idm": -0.0005,
    "follow.dist": -0.05,
    "acceleration": -0.01,
}

State = Float[np.ndarray, "3 D"]
Cost = Callable[[State, Float[np.ndarray, " A"]], float]


@dataclass(frozen=True)
class Reward:
    """The reward of one role: the weights by term, and how each step term is computed."""

    weights: Mapping[str, float]
    costs: Mapping[str, Cost]

    def of_step(self, states: State, action: Float[np.ndarray, " A"]) -> dict[str, float]:
        """The weighted step terms for an action [SI units] that was taken in these states."""
        return {name: self.weights[name] * cost(states, action) for name, cost in self.costs.items()}

    def of_outcome(self, facts: Mapping[str, Any]) -> dict[str, float]:
        """The weighted outcome terms of a drive that ended."""
        true = {
            "completed": facts["completed"],
            "not_completed": not facts["completed"],
            "contact": facts["contact"],
            "order_kept": facts["order_kept"],
            "off_road": facts["ending"] == "off_road",
            "lane_end": facts["ending"] == "lane_end",
        }
        return {name: self.weights[name] * float(true[name]) for name in OUTCOME_TERMS if name in self.weights}


def reward_of(
    rule: GroupRule, role: int, weights: Mapping[str, float] | None, lane_width: float | None = None
) -> Reward:
    """The reward of a role under a group rule; without `weights`, the default of the rule.

    Raises `InputError` for a term that does not exist, and a weight that is not finite.
    """
    default = DEFAULT_FOR_MERGES if isinstance(rule, Merge) else DEFAULT_FOR_CAR_FOLLOWING
    costs = _costs(rule, role, lane_width)
    if weights is None:
        weights = {name: weight for name, weight in default.items() if name in costs or name in OUTCOME_TERMS}
    if wrong := [name for name, weight in weights.items() if not math.isfinite(weight)]:
        raise InputError(f"reward: got {weights[wrong[0]]} as the weight of {wrong[0]!r}, expected a finite number")
    if unknown := [name for name in weights if name not in costs and name not in OUTCOME_TERMS]:
        known = ", ".join([*costs, *OUTCOME_TERMS])
        raise InputError(f"reward: got the term {unknown[0]!r}, expected terms among {known}")
    return Reward(weights, {name: cost for name, cost in costs.items() if name in weights})


def step_terms(rule: GroupRule, role: int) -> tuple[str, ...]:
    """The names of all step terms of a role under a group rule."""
    return tuple(_costs(rule, role, None))


def _costs(rule: GroupRule, role: int, lane_width: float | None) -> dict[str, Cost]:
    if isinstance(rule, Merge):
        width = LaneConstants().width if lane_width is None else lane_width
        terms = lane_changing_terms(LaneRewardConfig(constants=LaneConstants(following=CONSTANTS, width=width)))
    else:
        terms = car_following_terms(RewardConfig(constants=CONSTANTS))
    costs: dict[str, Cost] = {name: partial(_alone, term, role) for name, term in terms.node.items()}
    for (sender, receiver), kind in expected_graph(rule).items():
        if receiver == role:
            costs |= {f"{kind}.{name}": partial(_of_pair, f, sender, role) for name, f in terms.edge[kind].items()}
    return costs


def _alone(term: Callable, role: int, states: State, action: Float[np.ndarray, " A"]) -> float:
    return float(term(torch.from_numpy(states[role]), torch.from_numpy(action)))


def _of_pair(term: Callable, sender: int, role: int, states: State, action: Float[np.ndarray, " A"]) -> float:
    del action
    return float(term(torch.from_numpy(states[sender]), torch.from_numpy(states[role])))
