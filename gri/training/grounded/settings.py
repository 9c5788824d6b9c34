"""Settings of the grounded training (`gri.training.grounded.train_grounded`)."""

from typing import Literal

import msgspec

from gri.training.grounded.augmentation import Augmentation, Shifts
from gri.training.grounded.constants_search import ConstantsSearch
from gri.training.grounded.optimal_scenes import OptimaSettings


class GroundedSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="gri"):
    """Sizes and learning rates of the three stages."""

    no_edge_prior: float = 0.9
    """p(z_ij = 0). The other types have equal shares of the rest."""
    ahead_only: bool = False
    """Rule out in the prior that a vehicle follows one that is behind it at the end of the scene."""
    likelihood: Literal["dense", "stepwise"] = "dense"
    """Laplace's approximation. `dense`: one matrix for a window's actions. `stepwise`: whole scenes in linear time."""
    graph_scenes: int | None = None
    """Number of scenes for which the posterior is computed; the encoder learns from these. None: all."""
    horizon: int = 19
    """Number of actions that a driver foresees, for the dense likelihood [steps]."""
    stride: int = 10
    """Steps from one window of the dense likelihood to the next."""
    judge: Literal["reward", "policy"] = "reward"
    """The likelihood that gives the posterior: that of the reward, or that of a policy planned on the reward."""
    planner_updates: int = 400
    planner_batch: int = 128
    reward_updates: int = 100
    reward_rate: float = 0.05
    reward_batch: int = 16
    reward_scenes: int = 256
    reward_prior: float = 0.0
    """Weight of Σψ² relative to the mean log-likelihood per vehicle [nats].

    The weights of terms on which the scenes have little information, such as collisions, then stay near 2.
    """
    constants: ConstantsSearch | msgspec.UnsetType = msgspec.UNSET
    """How the constants of a reward that learns them are searched; not set: as `ConstantsSearch` has it.

    The search also finds weights and rationality; of the other settings of the reward only `reward_prior` applies.
    """
    updates: int = 1000
    batch: int = 64
    policy_rate: float = 3e-3
    encoder_rate: float = 1e-3
    encoder_lead: int = 0
    """Updates of the encoder alone, before those of the policy. Wrong graphs would spoil a planned policy."""
    encoder_updates: int | None = None
    """Updates of the encoder during those of the policy, from its first on; None: as many as the policy's.

    With more updates, the encoder also learns the errors of the posterior.
    """
    reconstruction: Literal["drawn", "likely", "judged"] = "drawn"
    """Graphs under which the policy reproduces scenes.

    `drawn`: sampled from the encoder. `likely`: the encoder's most probable ones. `judged`: the posterior's most
    probable ones; then the policy learns only from scenes with a posterior.
    """
    return_batch: int = 32
    return_weight: float = 0.02
    """Weight of the return off the data relative to the reconstruction error [m²]."""
    return_fade: float = 1.0
    """Share of `return_weight` that remains at the end of training."""
    action_weight: float = 0.0
    """Weight of the squared error of actions, in units of the scale, relative to that of states [m²]."""
    optima: OptimaSettings | None = None
    """Imitate optimal scenes off the data, instead of maximising the return there.

    The policy is planned first. `return_batch`, `return_weight` and `return_fade` then apply to the distance to the
    optimal scenes.
    """
    optima_scale: float = 0.5
    """Distance to an optimal scene beyond which the error counts only linearly [m]."""
    return_headway: float | None = None
    """Smallest starting headway of an edge in the random graphs off the data [m]; None: no limit.

    With a limit, a test with shorter headways is a test with headways that were not trained.
    """
    augmentation: Augmentation = Augmentation()
    shifts: Shifts = Shifts()
