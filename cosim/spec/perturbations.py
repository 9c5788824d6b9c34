"""Perturbations: tagged blocks of a scenario, each graded by one `intensity`.

    perturbations:
      - {kind: headway_ratio, intensity: 0.5}

Perturbed sensors act during the history, too, so that the graph is inferred from what they show. All other
perturbations of a group begin at the take-over; those of the traffic act from the start of the simulation. Everything
except the intensity is fixed and stated in the docstring of each class. `neutral` is the intensity that changes
nothing, and `default_intensities` are those of a stress test. What each one reached is measured
(`cosim.perturb.effects`).
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
    """A vehicle from a neighbouring lane cuts in between the leader and its follower within 2 s.

    The follower is vehicle 1 in car following and vehicle 0 in a merge. The neighbour brakes with 3 m/s² to the
    follower's speed at the take-over minus the intensity [m/s]. It keeps this speed until 4 s after the take-over; then
    SUMO drives it again. Once its centre is within 1 m of the lane's centre, it is the leader for the policy. A group
    without a neighbour that fits into the gap with 1 m clearance to both vehicles is infeasible.
    """

    lateral_time: ClassVar[float] = 2.0  # [s]
    duration: ClassVar[float] = 4.0  # [s]
    deceleration: ClassVar[float] = 3.0  # [m/s^2]
    clearance: ClassVar[float] = 1.0  # [m]
    intensity: Annotated[float, Meta(ge=-50, le=50)]
    symbol, unit, neutral, default_intensities = "speed deficit", "m/s", 0.0, (0.0, 1.0, 2.0, 3.0, 4.0)


class ObservationNoise(PerturbationSpec, frozen=True, tag="observation_noise"):
    """White noise on the observed states of all three vehicles, history included.

    The standard deviation is σ for positions along the road, 0.2 σ for positions across it, and 0.5 σ/s for speeds.
    """

    across: ClassVar[float] = 0.2  # of σ
    speed: ClassVar[float] = 0.5  # [1/s] of σ
    intensity: Annotated[float, Meta(ge=0, le=100)]
    symbol, unit, neutral, default_intensities = "σ", "m", 0.0, (0.1, 0.25, 0.5, 1.0, 2.0)


class Dropout(PerturbationSpec, frozen=True, tag="dropout"):
    """At each step, the observed state of a vehicle is missing with this probability; its last one is used instead.

    The history is observed in the same way. Its first state is never missing, so no policy and no encoder ever gets an
    empty state. Acceleration and yaw rate of the vehicles that the policy drives are never missing, see
    `LocalizationLatency`.
    """

    intensity: Share
    symbol, unit, neutral, default_intensities = "probability", "", 0.0, (0.1, 0.2, 0.4, 0.6, 0.8)


class PerceptionLatency(PerturbationSpec, frozen=True, tag="perception_latency"):
    """Each driven vehicle perceives all other vehicles with a delay of the intensity [s], and itself without delay.

    The other vehicles include the second one that the policy drives. So each driven vehicle has its own view of the
    group, from which it infers its graph and decides.
    """

    intensity: Annotated[float, Meta(ge=0, le=60)]
    symbol, unit, neutral, default_intensities = "latency", "s", 0.0, (0.2, 0.4, 0.6, 0.8, 1.0)


class LocalizationLatency(PerturbationSpec, frozen=True, tag="localization_latency"):
    """Each driven vehicle knows its own position, heading and speed with a delay of the intensity [s].

    It perceives the other vehicles without delay, in the coordinates of the road. Its own acceleration and yaw rate are
    known without delay: a driver feels them, and they are sums of its own commands.
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


class DenserTraffic(PerturbationSpec, frozen=True, tag="denser_traffic"):
    """The density of the traffic in the study area [veh/km] is multiplied by this factor.

    In a queue, a higher density goes with a lower speed and a lower flow. So the bottleneck's limits are lowered, and
    the demand after the warm-up becomes what the road carries then (`cosim.perturb.traffic_demand`). Traffic without a
    bottleneck gets the factor on its demand, up to the capacity of the road.
    """

    intensity: Multiple
    symbol, unit, neutral, default_intensities = "factor", "", 1.0, (1.05, 1.1, 1.15, 1.2, 1.25)


class MoreTrucks(PerturbationSpec, frozen=True, tag="more_trucks"):
    """In every flow with trucks, trucks are at least this share of the vehicles; other classes keep their proportions.

    The bottleneck keeps its limits. The demand becomes what the queue before it carries with these vehicles at the same
    speed.
    """

    intensity: Share
    symbol, unit, neutral, default_intensities = "truck share", "", 0.0, (0.1, 0.2, 0.3, 0.4, 0.5)


class AggressiveDrivers(PerturbationSpec, frozen=True, tag="aggressive_drivers"):
    """This share of the vehicles of every class except trucks has aggressive drivers.

    Compared with the class, they have 0.6 times the desired time headway, 0.75 times the standstill gap, 1.5 times the
    acceleration, a comfortable deceleration of 4.5 m/s², and twice the lane-change parameters `assertive` and
    `speed_gain`. With the same demand they would dissolve the queue. So the demand becomes what the queue carries with
    these drivers at the same speed.
    """

    time_headway: ClassVar[float] = 0.6
    gap: ClassVar[float] = 0.75
    acceleration: ClassVar[float] = 1.5
    deceleration: ClassVar[float] = 4.5  # [m/s^2]
    lane_changing: ClassVar[float] = 2.0
    intensity: Share
    symbol, unit, neutral, default_intensities = "share", "", 0.0, (0.2, 0.4, 0.6, 0.8, 1.0)


class LowFriction(PerturbationSpec, frozen=True, tag="low_friction"):
    """No vehicle has a total acceleration, along and across its path together, above μ·g (friction circle).

    SUMO's drivers know it: they plan with a lower acceleration and braking, and slow down before bends. The policies do
    not know it: the road cuts the acceleration and the yaw rate that they command.
    """

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
    | PerceptionLatency
    | LocalizationLatency
    | ActionNoise
    | ActionDelay
    | DenserTraffic
    | MoreTrucks
    | AggressiveDrivers
    | LowFriction
)
CHANGES_DEMAND = (DenserTraffic, MoreTrucks, AggressiveDrivers, LowFriction)
"""Perturbations of vehicles and drivers of the demand, which must be described in the scenario."""
KINDS: dict[str, type[PerturbationSpec]] = {str(kind.__struct_config__.tag): kind for kind in Perturbation.__args__}
RENAMED = {
    "latency": "perception_latency (others are seen late) and localization_latency (the own position is late); give one"
    " of them, or both for the former meaning",
    "denser_demand": "denser_traffic, whose intensity is a factor on the density; give that",
}
"""Kinds of version 0.1 and what to write instead."""
