"""Settings of the grounded training (`gri.training.grounded.train_grounded`)."""

from typing import Literal

import msgspec

from gri.training.grounded.augmentation import Augmentation, Shifts
from gri.training.grounded.optimal_scenes import OptimaSettings


class GroundedSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="gri"):
    """Sizes and rates of the three stages."""

    no_edge_prior: float = 0.9
    ahead_only: bool = False
    """Nobody follows a vehicle that ends up behind it; else only the reward says so."""
    likelihood: Literal["dense", "stepwise"] = "dense"
    """Laplace's approximation by one matrix over a window's actions, or over whole scenes in linear time."""
    graph_scenes: int | None = None
    """The posterior over graphs is computed for so many scenes, and the encoder learns from these; None: all."""
    horizon: int = 19
    """Actions that a driver is taken to foresee when the likelihood of graphs is computed."""
    stride: int = 10
    judge: Literal["reward", "policy"] = "reward"
    """Whose likelihood tells graphs apart: the reward's own, or that of a policy first planned on it."""
    planner_updates: int = 400
    planner_batch: int = 128
    reward_updates: int = 100
    reward_rate: float = 0.05
    reward_batch: int = 16
    reward_scenes: int = 256
    reward_prior: float = 0.0
    """Weight of Σψ² against the mean log-likelihood per vehicle [nats]: a term of which the scenes say little, as of
    collisions where nobody comes near, keeps about the weight of one unit.
    """
    updates: int = 1000
    batch: int = 64
    policy_rate: float = 3e-3
    encoder_rate: float = 1e-3
    encoder_lead: int = 0
    """Updates of the encoder before the policy's first: graphs that are still wrong undo what a plan has taught it."""
    encoder_updates: int | None = None
    """Updates of the encoder beside the policy's, from its first on; None: as many. More repeat the posterior's errors.
    """
    reconstruction: Literal["drawn", "likely", "judged"] = "drawn"
    """Under which graphs recorded scenes are reproduced: drawn from the encoder, its most probable ones, or those of
    the posterior, which knows what is to be reproduced; the policy then learns from the scenes that have one.
    """
    return_batch: int = 32
    return_weight: float = 0.02
    return_fade: float = 1.0
    """Share of the return's weight that is left at the end of its decline: reconstruction has the last word."""
    action_weight: float = 0.0
    """Weight of the squared error of actions, in units of the scale, beside that of states [m²]."""
    optima: OptimaSettings | None = None
    """Imitate optima of the return away from the data instead of climbing to them beside the reconstruction.

    The policy is planned first; the return's batch, weight and fade become those of the distance to the optima.
    """
    optima_scale: float = 0.5
    """Distance [m] from which on being far from an optimum counts linearly only."""
    return_headway: float | None = None
    """Least starting headway [m] over which a vehicle may react where the return is maximised away from the data.

    None: any. A test of shorter headways is then one of headways never trained.
    """
    augmentation: Augmentation = Augmentation()
    shifts: Shifts = Shifts()
