"""Perturbations: tagged blocks of a scenario, each graded by one `intensity`.

    perturbations:
      - {kind: headway_ratio, intensity: 0.5}

The graph is inferred from the undisturbed history; then, at the take-over, the perturbation begins. Everything except
the intensity is fixed and stated in the docstring of each class. `neutral` is the intensity that changes nothing, and
`default_intensities` are those of a stress test.
"""

from typing import Annotated, ClassVar

from msgspec import Meta, Struct

from cosim.spec.demand import Multiple, Share


class PerturbationSpec(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"):
    """Base of all perturbations; `symbol` and `unit` are those of the intensity."""

    symbol: ClassVar[str]
    unit: ClassVar[str]
    neutral: ClassVar[float]
    default_intensities: ClassVar[tuple[float, ...]]

    @property
    def kind(self) -> str:
        """The name of the perturbation in YAML and in tables."""
        return str(self.__struct_config__.tag)


class HeadwayRatio(PerturbationSpec, frozen=True, tag="headway_ratio"):
    """The follower starts closer to its leader: Δx' = (1 − δ)·Δx, with Δx from front to front (paper, Sec. VI-E).

    The follower is vehicle 0. Its leader is vehicle 1 in car following and vehicle 2 in a merge. With δ ≥ 1 it starts
    beside or ahead of its leader, which needs two lanes.
    """

    intensity: Annotated[float, Meta(ge=-10, le=10)]
    symbol, unit, neutral, default_intensities = "δ", "", 0.0, (0.25, 0.5, 0.75, 1.0, 1.25)


class HeadwayMetres(PerturbationSpec, frozen=True, tag="headway_metres"):
    """The follower (see `HeadwayRatio`) starts farther ahead by the intensity [m]."""

    intensity: Annotated[float, Meta(ge=-1000, le=1000)]
    symbol, unit, neutral, default_intensities = "shift", "m", 0.0, (2.0, 4.0, 6.0, 8.0, 10.0)


class SpeedOffset(PerturbationSpec, frozen=True, tag="speed_offset"):
    """Vehicle 0 starts faster by the intensity [m/s], with unchanged acceleration; its speed is not below 0."""

    intensity: Annotated[float, Meta(ge=-50, le=50)]
    symbol, unit, neutral, default_intensities = "Δv", "m/s", 0.0, (1.0, 2.0, 3.0, 4.0, 6.0)


class RemoveThird(PerturbationSpec, frozen=True, tag="remove_third"):
    """Vehicle 2 is removed, and the headway of the other two is reduced by the ratio δ (paper, Sec. VI-E).

    Instead of vehicle 2, the policy observes a phantom that drives 500 m ahead at constant speed and has no edges. In
    car following, vehicle 0 moves towards vehicle 1; in a merge, the lag vehicle 1 moves towards the merging vehicle 0.
    """

    intensity: Annotated[float, Meta(ge=-10, le=10)]
    symbol, unit, neutral, default_intensities = "δ", "", 0.0, (0.0, 0.2, 0.4, 0.6, 0.7)


class LeaderBraking(PerturbationSpec, frozen=True, tag="leader_braking"):
    """Vehicle 2 brakes with the intensity [m/s²] for 2 s, or to standstill; then SUMO drives it again."""

    duration: ClassVar[float] = 2.0  # [s]
    intensity: Annotated[float, Meta(ge=0, le=50)]
    symbol, unit, neutral, default_intensities = "deceleration", "m/s²", 0.0, (2.0, 3.0, 4.0, 6.0, 8.0)


class NeighbourCutIn(PerturbationSpec, frozen=True, tag="neighbour_cut_in"):
    """A vehicle from a neighbouring lane cuts in between vehicle 2 and its follower within 2 s.

    The follower is vehicle 1 in car following and vehicle 0 in a merge. The neighbour brakes with 3 m/s² to the
    follower's speed at the take-over minus the intensity [m/s]. It keeps this speed until 4 s after the take-over; then
    SUMO drives it again. Once its centre is within 1 m of the lane's centre, it is vehicle 2 for the policy. A group
    without a neighbour that fits into the gap with 1 m clearance to both vehicles is infeasible.
    """

    lateral_time: ClassVar[float] = 2.0  # [s]
    duration: ClassVar[float] = 4.0  # [s]
    deceleration: ClassVar[float] = 3.0  # [m/s^2]
    clearance: ClassVar[float] = 1.0  # [m]
    intensity: Annotated[float, Meta(ge=-50, le=50)]
    symbol, unit, neutral, default_intensities = "speed deficit", "m/s", 0.0, (0.0, 1.0, 2.0, 3.0, 4.0)


class ObservationNoise(PerturbationSpec, frozen=True, tag="observation_noise"):
    """White noise on the observed states of all three vehicles.

    The standard deviation is σ for positions along the road, 0.2 σ for positions across it, and 0.5 σ/s for speeds.
    """

    across: ClassVar[float] = 0.2  # of σ
    speed: ClassVar[float] = 0.5  # [1/s] of σ
    intensity: Annotated[float, Meta(ge=0, le=100)]
    symbol, unit, neutral, default_intensities = "σ", "m", 0.0, (0.1, 0.25, 0.5, 1.0, 2.0)


class Dropout(PerturbationSpec, frozen=True, tag="dropout"):
    """At each step, the observed state of a vehicle is missing with this probability; its last one is used.

    Acceleration and yaw rate of the vehicles that the policy drives are never missing, see `Latency`.
    """

    intensity: Share
    symbol, unit, neutral, default_intensities = "probability", "", 0.0, (0.1, 0.2, 0.4, 0.6, 0.8)


class Latency(PerturbationSpec, frozen=True, tag="latency"):
    """The policy observes all three vehicles with a delay of the intensity [s].

    The acceleration and the yaw rate of the vehicles that it drives are observed without delay: a driver feels them,
    and they are sums of its own commands. With a delay, every policy that commands jerk would oscillate.
    """

    intensity: Annotated[float, Meta(ge=0, le=60)]
    symbol, unit, neutral, default_intensities = "latency", "s", 0.0, (0.2, 0.4, 0.6, 0.8, 1.0)


class ActionNoise(PerturbationSpec, frozen=True, tag="action_noise"):
    """White noise with standard deviation σ on the applied jerk, and with 0.02 rad/m · σ on the yaw acceleration."""

    yaw: ClassVar[float] = 0.02  # [rad/m]
    intensity: Annotated[float, Meta(ge=0, le=1000)]
    symbol, unit, neutral, default_intensities = "σ", "m/s³", 0.0, (0.5, 1.0, 2.0, 4.0, 8.0)


class ActionDelay(PerturbationSpec, frozen=True, tag="action_delay"):
    """Actions are applied with a delay of the intensity [s]; before the first one, the action is zero."""

    intensity: Annotated[float, Meta(ge=0, le=60)]
    symbol, unit, neutral, default_intensities = "delay", "s", 0.0, (0.2, 0.4, 0.6, 0.8, 1.0)


class DenserDemand(PerturbationSpec, frozen=True, tag="denser_demand"):
    """All flows are multiplied by this factor."""

    intensity: Multiple
    symbol, unit, neutral, default_intensities = "factor", "", 1.0, (1.05, 1.1, 1.15, 1.2, 1.25)


class MoreTrucks(PerturbationSpec, frozen=True, tag="more_trucks"):
    """In every flow with trucks, trucks are this share of the vehicles; the other classes keep their proportions."""

    intensity: Share
    symbol, unit, neutral, default_intensities = "truck share", "", 0.0, (0.1, 0.2, 0.3, 0.4, 0.5)


class AggressiveDrivers(PerturbationSpec, frozen=True, tag="aggressive_drivers"):
    """This share of the vehicles of every class except trucks has aggressive drivers.

    Compared with the class, they have 0.6 times the desired time headway, 0.75 times the standstill gap, 1.5 times the
    acceleration, a comfortable deceleration of 4.5 m/s², and twice the lane-change parameters `assertive` and
    `speed_gain`.
    """

    time_headway: ClassVar[float] = 0.6
    gap: ClassVar[float] = 0.75
    acceleration: ClassVar[float] = 1.5
    deceleration: ClassVar[float] = 4.5  # [m/s^2]
    lane_changing: ClassVar[float] = 2.0
    intensity: Share
    symbol, unit, neutral, default_intensities = "share", "", 0.0, (0.2, 0.4, 0.6, 0.8, 1.0)


class LowFriction(PerturbationSpec, frozen=True, tag="low_friction"):
    """No vehicle accelerates or brakes harder than μ·g. SUMO's drivers take this into account; the policies do not."""

    intensity: Annotated[float, Meta(ge=0.01, le=10)]
    symbol, unit, neutral, default_intensities = "μ", "", 1.0, (0.6, 0.4, 0.3, 0.2, 0.15)


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
CHANGES_DEMAND = (DenserDemand, MoreTrucks, AggressiveDrivers, LowFriction)
"""Perturbations of vehicles and drivers of the demand, which must be described in the scenario."""
KINDS: dict[str, type[PerturbationSpec]] = {str(kind.__struct_config__.tag): kind for kind in Perturbation.__args__}
