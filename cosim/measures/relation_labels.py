"""Which vehicle reacts to which in SUMO's traffic: labels of ordered pairs, per step, and their reduction to one graph.

The label of i → j at step t says how j reacts to i from t to t + 1: j follows i, yields to i, cuts in ahead of i, or
does not react (`gri.core.edges.LANE_CHANGING`). Where several apply, the last of these counts. There are two sources of
labels. *Gold* labels come from interventions in copies of the simulation (`reactions_by_intervention`). *Rule* labels
come from what SUMO reports about its drivers (`reactions_by_rule`). docs/scene-labels.md explains both.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Bool, Float, Int

from gri.core.edges import LANE_CHANGING, EdgeType, pairs

NO_VEHICLE = -1
NONE, FOLLOW, YIELD, CUT_IN = (
    LANE_CHANGING.index(kind) for kind in (EdgeType.NONE, EdgeType.FOLLOW, EdgeType.YIELD, EdgeType.CUT_IN)
)
REACTION_THRESHOLD = -0.1  # [m/s²]; an effect above this (weaker) counts as no reaction
CUT_IN_THRESHOLD = -0.5  # [m/s²]; effect on the new follower from which on a lane change counts as a cut-in
CUT_IN_MARGIN = 2.0  # [m] beyond SUMO's secure gap; by rule, a lane change that leaves less is a cut-in
TOLERANCE = 0.05  # [m/s²], of the comparisons in the rules
HARDEST_BRAKING = 9.0  # [m/s²]
CUT_IN_WINDOW = 2.0  # [s] after a lane change in which its effect on the new follower is looked for
LANE_CHANGE_HOLD = 1.0  # [s] for which the label of a lane change, which SUMO makes in one step, is kept

VehicleNumbers = Int[np.ndarray, "S N T"]
Values = Float[np.ndarray, "S N T"]
Flags = Bool[np.ndarray, "S N T"]


@dataclass(frozen=True)
class DriverRecords:
    """What SUMO reports about the N vehicles of S scenes at T steps. SI units; `NO_VEHICLE` stands for no vehicle."""

    vehicle: Int[np.ndarray, "S N"]
    """Number of each vehicle; the fields of type `VehicleNumbers` refer to it."""
    v: Values
    v_next: Values
    """Speed one simulation step later [m/s]."""
    free_speed: Values
    """Speed it would have one simulation step later without a leader [m/s]."""
    speed_behind_leader: Values
    """Speed that its car-following model allows behind its leader [m/s]; inf without a leader."""
    speed_behind_target: Values
    """Speed that its car-following model would allow behind its target [m/s]; inf without a target."""
    imperfection: Values
    """By how much its random imperfection may lower its acceleration at most [m/s²]."""
    leader: VehicleNumbers
    requester: VehicleNumbers
    """The vehicle that asks it to make room, because it is in the way of an urgent lane change."""
    target: VehicleNumbers
    """The vehicle behind which it would drive in the lane that it urgently wants to change to."""
    cooperative_change: Flags
    """Whether it changes lanes in the next step to make room for another vehicle."""
    new_follower: VehicleNumbers
    """The vehicle ahead of which it came to drive by a lane change in the step that ends."""
    new_follower_margin: Values
    """Gap to `new_follower` minus SUMO's secure gap [m]; inf where there is none."""
    dt: float
    """Simulation step [s]."""
    stride: int = 1
    """Simulation steps from one of the T steps to the next."""

    def steps(self, seconds: float) -> int:
        """A duration in steps of the scenes; at least 1."""
        return max(round(seconds / (self.dt * self.stride)), 1)


@dataclass(frozen=True)
class Reaction:
    """To which vehicle each vehicle reacts in one way, and the acceleration that it owes to this [m/s²] (negative)."""

    to: VehicleNumbers
    effect: Values


@dataclass(frozen=True)
class Reactions:
    """The reactions of all vehicles, one `Reaction` per edge type."""

    follow: Reaction
    yielding: Reaction
    cut_in: Reaction


@dataclass(frozen=True)
class PairLabels:
    """Labels of the E ordered pairs of each scene, in the order of `gri.core.edges.pairs`.

    `types` are indices into `LANE_CHANGING`. `effect` is the acceleration [m/s²] that the receiver owes to the sender;
    for a cut-in, the one that the sender (the new follower) owes to the receiver.
    """

    types: Int[np.ndarray, "S E T"]
    effect: Float[np.ndarray, "S E T"]


def reactions_by_rule(records: DriverRecords) -> Reactions:
    """Reactions from what SUMO reports, without any intervention.

    Follow: the car-following model allows less behind the leader than the free speed, and the vehicle is not slower
    than that. Yield: another vehicle asks for room, and the vehicle is slower than its model and its imperfection
    explain. Without a request, such a vehicle may follow its target already (`_adapts_to_target`). Cut-in: a lane
    change leaves the new follower less than its secure gap plus `CUT_IN_MARGIN`.
    """
    lowest = np.maximum(records.v - HARDEST_BRAKING * records.dt, 0.0)
    allowed = np.minimum(np.maximum(records.speed_behind_leader, lowest), records.free_speed)
    effect = (allowed - records.free_speed) / records.dt
    shortfall = _unexplained_deceleration(records)
    held_by_leader = (records.leader != NO_VEHICLE) & (effect < REACTION_THRESHOLD) & (shortfall >= 0)
    yields = (records.requester != NO_VEHICLE) & (shortfall < 0)
    adapts = _adapts_to_target(records, shortfall) & (records.requester == NO_VEHICLE)
    follow = _follow(records, held_by_leader, effect, adapts, shortfall)
    yielding = Reaction(np.where(yields, records.requester, NO_VEHICLE), np.where(yields, shortfall - TOLERANCE, 0.0))
    cut_in_on = np.where(records.new_follower_margin < CUT_IN_MARGIN, records.new_follower, NO_VEHICLE)
    return _add_lane_changes(records, follow, yielding, cut_in_on)


def reactions_by_intervention(
    records: DriverRecords, effect_of_leader: Values, effect_of_requests: Values
) -> Reactions:
    """Reactions from interventions in copies of the simulation.

    The effects [m/s²] are the acceleration in the simulation minus the one in a copy in which the vehicle ignores its
    leader, or all requests to make room. An intervention of one step cannot show what a vehicle does for its own lane
    change: `_adapts_to_target` is a rule here, too.
    """
    held_by_leader = (records.leader != NO_VEHICLE) & (effect_of_leader < REACTION_THRESHOLD)
    yields = (records.requester != NO_VEHICLE) & (effect_of_requests < REACTION_THRESHOLD)
    shortfall = _unexplained_deceleration(records)
    adapts = _adapts_to_target(records, shortfall) & ~yields
    follow = _follow(records, held_by_leader, effect_of_leader, adapts, shortfall)
    yielding = Reaction(np.where(yields, records.requester, NO_VEHICLE), np.where(yields, effect_of_requests, 0.0))
    return _add_lane_changes(records, follow, yielding, None)


def _unexplained_deceleration(records: DriverRecords) -> Values:
    """Acceleration minus the lowest one that the model and the imperfection explain [m/s²]; negative: unexplained."""
    lowest = np.maximum(records.v - HARDEST_BRAKING * records.dt, 0.0)
    allowed = np.maximum(np.minimum(records.speed_behind_leader, records.free_speed), lowest)
    return (records.v_next - allowed) / records.dt + records.imperfection + TOLERANCE


def _adapts_to_target(records: DriverRecords, shortfall: Values) -> Flags:
    """Where a vehicle already adapts its speed to its target.

    It is slower than its own leader explains, and not slower than its model would allow behind the target.
    """
    above_target = (records.v_next - records.speed_behind_target) / records.dt + records.imperfection + TOLERANCE
    return (records.target != NO_VEHICLE) & (shortfall < 0) & (above_target >= 0)


def _follow(
    records: DriverRecords, held_by_leader: Flags, effect: Values, adapts: Flags, shortfall: Values
) -> Reaction:
    """Following the leader, or else the target."""
    adapts = adapts & ~held_by_leader
    to = np.where(held_by_leader, records.leader, np.where(adapts, records.target, NO_VEHICLE))
    return Reaction(to, np.where(held_by_leader, effect, np.where(adapts, shortfall - TOLERANCE, 0.0)))


def _add_lane_changes(
    records: DriverRecords, follow: Reaction, yielding: Reaction, cut_in_on: VehicleNumbers | None
) -> Reactions:
    """Add cooperative lane changes (yielding) and cut-ins, whose labels are kept for `LANE_CHANGE_HOLD`.

    Without `cut_in_on`, a lane change is a cut-in where the interventions show an effect on the new follower.
    """
    hold = records.steps(LANE_CHANGE_HOLD)
    made_room_for = _hold(np.where(records.cooperative_change, records.requester, NO_VEHICLE), hold)
    made_room = (yielding.to == NO_VEHICLE) & (made_room_for != NO_VEHICLE)
    yielding = Reaction(np.where(made_room, made_room_for, yielding.to), yielding.effect)
    return Reactions(follow, yielding, _cut_ins(records, follow, cut_in_on, hold))


def _cut_ins(records: DriverRecords, follow: Reaction, cut_in_on: VehicleNumbers | None, hold: int) -> Reaction:
    to, effect = np.full_like(records.new_follower, NO_VEHICLE), np.zeros_like(records.v)
    changes = records.new_follower if cut_in_on is None else cut_in_on
    for scene, j, t in np.argwhere(changes != NO_VEHICLE).tolist():
        strongest = _effect_on_new_follower(records, follow, scene, j, t)
        if cut_in_on is not None or strongest < CUT_IN_THRESHOLD:
            to[scene, j, t : t + hold] = records.new_follower[scene, j, t]
            effect[scene, j, t : t + hold] = strongest
    return Reaction(to, effect)


def _effect_on_new_follower(records: DriverRecords, follow: Reaction, scene: int, j: int, t: int) -> float:
    """Strongest effect [m/s²] of vehicle j on its new follower, within `CUT_IN_WINDOW` of j's lane change at t."""
    follower = np.flatnonzero(records.vehicle[scene] == records.new_follower[scene, j, t])
    window = slice(t, t + records.steps(CUT_IN_WINDOW))
    follows_j = follow.to[scene, follower, window] == records.vehicle[scene, j]
    return float(follow.effect[scene, follower, window][follows_j].min(initial=0.0))


def _hold(numbers: VehicleNumbers, steps: int) -> VehicleNumbers:
    """The same numbers, each kept for `steps` steps where no other follows."""
    held = numbers.copy()
    for later in range(1, min(steps, numbers.shape[-1])):
        shifted = np.full_like(numbers, NO_VEHICLE)
        shifted[..., later:] = numbers[..., :-later]
        held = np.where(held == NO_VEHICLE, shifted, held)
    return held


def pair_labels(reactions: Reactions, vehicle: Int[np.ndarray, "S N"]) -> PairLabels:
    """Labels of all ordered pairs i → j. Cut-in goes before yield, yield before follow."""
    ordered = (FOLLOW, reactions.follow), (YIELD, reactions.yielding), (CUT_IN, reactions.cut_in)
    types, effects = [], []
    for i, j in pairs(vehicle.shape[1]):
        type_, effect = np.zeros_like(reactions.follow.to[:, j]), np.zeros_like(reactions.follow.effect[:, j])
        for index, reaction in ordered:
            reacts = reaction.to[:, j] == vehicle[:, i, None]
            type_, effect = np.where(reacts, index, type_), np.where(reacts, reaction.effect[:, j], effect)
        types.append(type_)
        effects.append(effect)
    return PairLabels(np.stack(types, 1), np.stack(effects, 1))


class Reduction(StrEnum):
    """How the labels of all steps of a scene become one constant graph."""

    STRONGEST = "strongest"
    """The type with the strongest effect at any step; of equally strong ones, the type that lasts longer."""
    LONGEST = "longest"
    """The type of most steps; "none" is a type, too."""


def reduce_labels(
    labels: PairLabels, method: Reduction, clear_steps: int
) -> tuple[Int[np.ndarray, "S E"], Bool[np.ndarray, "S E"]]:
    """One type per pair, as an index into `LANE_CHANGING`, and whether it is unambiguous.

    A pair is unambiguous if it never interacts, or if it interacts in one way only, for at least `clear_steps` steps in
    total.
    """
    kinds = np.arange(len(LANE_CHANGING))
    is_type = labels.types[..., None] == kinds  # Shape: (S, E, T, K)
    steps = is_type.sum(2)
    if method is Reduction.LONGEST:
        chosen = steps.argmax(-1)
    else:
        strength = np.where(is_type, np.abs(labels.effect)[..., None], 0.0).max(2, initial=0.0)
        present = steps > 0
        present[..., NONE] = False
        score = np.where(present, strength + 1e-6 * steps, -np.inf)
        chosen = score.argmax(-1)  # "none", which comes first, where no interaction is present
    interactions = (steps[..., 1:] > 0).sum(-1)
    long_enough = steps[..., 1:].sum(-1) >= clear_steps
    return chosen, (interactions == 0) | ((interactions == 1) & long_enough)
