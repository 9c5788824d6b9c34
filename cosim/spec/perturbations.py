"""Perturbations: tagged blocks of a scenario, each graded by one `intensity`.

    perturbations:
      - {kind: headway_ratio, intensity: 0.5}

The graph is inferred from the undisturbed history; then, at the take-over, the intervention happens. Everything but the
intensity is fixed and stated with each class. `neutral` is the intensity that changes nothing, `grades` are the default
ones of a stress test.
"""

from typing import Annotated, ClassVar

from msgspec import Meta, Struct

NonNegative = Annotated[float, Meta(ge=0)]
Positive = Annotated[float, Meta(gt=0)]
Share = Annotated[float, Meta(ge=0, le=1)]


class Spec(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"):
    """Base of all perturbations."""

    symbol: ClassVar[str]
    unit: ClassVar[str]
    neutral: ClassVar[float]
    grades: ClassVar[tuple[float, ...]]

    @property
    def kind(self) -> str:
        """The word that stands for it in YAML and in tables."""
        return str(self.__struct_config__.tag)


class HeadwayRatio(Spec, frozen=True, tag="headway_ratio"):
    """The follower starts nearer to its leader: Δx' = (1 − δ)·Δx with Δx from front to front (Sec. VI-E).

    The follower is vehicle 0; its leader is 1 in car following and 2 in a merge. δ ≥ 1 puts it beside or ahead of its
    leader, which takes two lanes.
    """

    intensity: float
    symbol, unit, neutral, grades = "δ", "", 0.0, (0.25, 0.5, 0.75, 1.0, 1.25)


class HeadwayMetres(Spec, frozen=True, tag="headway_metres"):
    """The follower (see `HeadwayRatio`) starts so many metres farther ahead."""

    intensity: float
    symbol, unit, neutral, grades = "shift", "m", 0.0, (2.0, 4.0, 6.0, 8.0, 10.0)


class SpeedOffset(Spec, frozen=True, tag="speed_offset"):
    """Vehicle 0 starts so much faster, its acceleration is what it was; never slower than standing."""

    intensity: float
    symbol, unit, neutral, grades = "Δv", "m/s", 0.0, (1.0, 2.0, 3.0, 4.0, 6.0)


class RemoveThird(Spec, frozen=True, tag="remove_third"):
    """Vehicle 2 vanishes and the headway of the two that are left is shifted by the ratio δ (Sec. VI-E).

    In its place the policy is shown a phantom that drives 500 m ahead at the same speed for ever, without any edge. In
    car following vehicle 0 moves towards 1, in a merge the lag vehicle 1 towards the merging vehicle 0.
    """

    intensity: float
    symbol, unit, neutral, grades = "δ", "", 0.0, (0.0, 0.2, 0.4, 0.6, 0.7)


class LeaderBraking(Spec, frozen=True, tag="leader_braking"):
    """Vehicle 2 brakes so hard for 2 s, or until it stands, and is then SUMO's again."""

    duration: ClassVar[float] = 2.0  # [s]
    intensity: NonNegative
    symbol, unit, neutral, grades = "deceleration", "m/s²", 0.0, (2.0, 3.0, 4.0, 6.0, 8.0)


class NeighbourCutIn(Spec, frozen=True, tag="neighbour_cut_in"):
    """A neighbour cuts in between vehicle 2 and its follower in 2 s, and is vehicle 2 for the policy from then on.

    Vehicle 2's follower is 1 in car following and 0 in a merge. The neighbour brakes at 3 m/s² to a speed so much below
    the follower's at the take-over, keeps that to the end of the fourth second, and is then SUMO's again. It counts as
    vehicle 2 once its centre is within 1 m of the lane's. A group without a neighbour that fits into the gap, 1 m clear
    of both, is infeasible.
    """

    lateral_time: ClassVar[float] = 2.0  # [s]
    duration: ClassVar[float] = 4.0  # [s]
    deceleration: ClassVar[float] = 3.0  # [m/s^2]
    clearance: ClassVar[float] = 1.0  # [m]
    intensity: float
    symbol, unit, neutral, grades = "speed deficit", "m/s", 0.0, (0.0, 1.0, 2.0, 3.0, 4.0)


class ObservationNoise(Spec, frozen=True, tag="observation_noise"):
    """White noise on what the policy sees of all three: positions σ along and 0.2 σ across the road, speeds 0.5 σ/s."""

    across: ClassVar[float] = 0.2  # of σ
    speed: ClassVar[float] = 0.5  # [1/s] of σ
    intensity: NonNegative
    symbol, unit, neutral, grades = "σ", "m", 0.0, (0.1, 0.25, 0.5, 1.0, 2.0)


class Dropout(Spec, frozen=True, tag="dropout"):
    """Each vehicle's state is missing with this probability in each step; the last one that was seen stands for it.

    Not so the acceleration and the yaw rate of vehicles that the policy drives, see `Latency`.
    """

    intensity: Share
    symbol, unit, neutral, grades = "probability", "", 0.0, (0.1, 0.2, 0.4, 0.6, 0.8)


class Latency(Spec, frozen=True, tag="latency"):
    """The policy sees all three as they were so long ago.

    Of the vehicles that it drives it knows acceleration and yaw rate at once: a driver feels them, and they are sums of
    its own commands. Were they late, too, every policy that acts by jerk would chase its own past.
    """

    intensity: NonNegative
    symbol, unit, neutral, grades = "latency", "s", 0.0, (0.2, 0.4, 0.6, 0.8, 1.0)


class ActionNoise(Spec, frozen=True, tag="action_noise"):
    """White noise on the jerk that is applied; on the yaw acceleration 0.02 rad/m of it."""

    yaw: ClassVar[float] = 0.02  # [rad/m]
    intensity: NonNegative
    symbol, unit, neutral, grades = "σ", "m/s³", 0.0, (0.5, 1.0, 2.0, 4.0, 8.0)


class ActionDelay(Spec, frozen=True, tag="action_delay"):
    """Actions are applied so much later than the policy chose them; until then none."""

    intensity: NonNegative
    symbol, unit, neutral, grades = "delay", "s", 0.0, (0.2, 0.4, 0.6, 0.8, 1.0)


class DenserDemand(Spec, frozen=True, tag="denser_demand"):
    """All flows are multiplied by this factor."""

    intensity: Positive
    symbol, unit, neutral, grades = "factor", "", 1.0, (1.05, 1.1, 1.15, 1.2, 1.25)


class MoreTrucks(Spec, frozen=True, tag="more_trucks"):
    """In every flow that has trucks they are this share of the vehicles; the other classes keep their proportions."""

    intensity: Share
    symbol, unit, neutral, grades = "truck share", "", 0.0, (0.1, 0.2, 0.3, 0.4, 0.5)


class AggressiveDrivers(Spec, frozen=True, tag="aggressive_drivers"):
    """This share of every class but trucks is driven aggressively.

    That is: a desired time headway of 0.6 and standstill gaps of 0.75 of the others', 1.5 times their acceleration,
    4.5 m/s² of comfortable braking, twice their assertiveness and their eagerness to gain speed by changing lanes.
    """

    time_headway: ClassVar[float] = 0.6
    gap: ClassVar[float] = 0.75
    acceleration: ClassVar[float] = 1.5
    deceleration: ClassVar[float] = 4.5  # [m/s^2]
    lane_changing: ClassVar[float] = 2.0
    intensity: Share
    symbol, unit, neutral, grades = "share", "", 0.0, (0.2, 0.4, 0.6, 0.8, 1.0)


class LowFriction(Spec, frozen=True, tag="low_friction"):
    """Nobody, driven or not, accelerates or brakes harder than μ·g. SUMO's drivers know that, the policies do not."""

    intensity: Positive
    symbol, unit, neutral, grades = "μ", "", 1.0, (0.6, 0.4, 0.3, 0.2, 0.15)


Demand = DenserDemand | MoreTrucks | AggressiveDrivers | LowFriction
Start = HeadwayRatio | HeadwayMetres | SpeedOffset | RemoveThird
Background = LeaderBraking | NeighbourCutIn
Signal = ObservationNoise | Dropout | Latency | ActionNoise | ActionDelay | LowFriction
Perturbation = (
    HeadwayRatio
    | HeadwayMetres
    | SpeedOffset
    | RemoveThird
    | LeaderBraking
    | NeighbourCutIn
    | ObservationNoise
    | Dropout
    | Latency
    | ActionNoise
    | ActionDelay
    | DenserDemand
    | MoreTrucks
    | AggressiveDrivers
    | LowFriction
)
KINDS: dict[str, type[Spec]] = {str(kind.__struct_config__.tag): kind for kind in Perturbation.__args__}
