"""Who reacts to whom in SUMO's traffic: labels of ordered pairs, step by step, and their reduction to one graph.

The label of i → j at step t says what j does towards i from t to t + 1: it follows i, yields to i, cuts in before i, or
nothing (`gri.core.graph.LANE_CHANGING`); several at once count as the last of them. *Gold* labels come from
interventions in copies of the simulation, *rule* labels from what SUMO says of its drivers. docs/scene-labels.md.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Bool, Float, Int

from gri.core.edges import LANE_CHANGING, EdgeType, pairs

NOBODY = -1
NONE, FOLLOW, YIELD, CUT_IN = (
    LANE_CHANGING.index(kind) for kind in (EdgeType.NONE, EdgeType.FOLLOW, EdgeType.YIELD, EdgeType.CUT_IN)
)
FELT = -0.1  # [m/s²]; weaker effects count as none
CUT = -0.5  # [m/s²], of whoever is cut in on
ROOM = 2.0  # [m] beyond SUMO's secure gap; a lane change that leaves less is a cut-in by rule
SLACK = 0.05  # [m/s²], of the rules
HARDEST = 9.0  # [m/s²], braking
FEEL, HOLD = 2.0, 1.0  # [s] in which a cut-in is felt, and for which an instant change keeps its label

Numbers = Int[np.ndarray, "S N T"]
Values = Float[np.ndarray, "S N T"]
Flags = Bool[np.ndarray, "S N T"]


@dataclass(frozen=True)
class DriverRecords:
    """What SUMO says of the N vehicles of S scenes at T steps. SI units; vehicles are numbers, `NOBODY` is none."""

    vehicle: Int[np.ndarray, "S N"]
    v: Values
    v_next: Values
    """One simulation step later."""
    free: Values
    """Speed it would have then without anybody ahead."""
    behind: Values
    """Speed its car-following model allows behind its leader; inf where it has none."""
    beside: Values
    """The same behind its target."""
    noise: Values
    """By how much it may fall short of what its model allows, at random [m/s²]."""
    leader: Numbers
    asker: Numbers
    """Who asks it to make room: urgently wants the lane it is in, and it is what is in the way."""
    target: Numbers
    """Behind whom it would drive in the lane that it urgently wants to itself."""
    gave_way: Flags
    """It changed lanes to help in the step that follows."""
    cut: Numbers
    """Before whom it came to drive by a lane change in the step that ends."""
    room: Values
    """Gap to that vehicle beyond what SUMO calls secure [m]; inf where there is none."""
    dt: float
    """Of the simulation [s]."""
    every: int = 1
    """Simulation steps from one of the T steps to the next."""

    def steps(self, seconds: float) -> int:
        """A duration in steps of the scenes."""
        return max(round(seconds / (self.dt * self.every)), 1)


@dataclass(frozen=True)
class Response:
    """Whom vehicles heed in one way, and by how much faster they would be without it (negative) [m/s²]."""

    whom: Numbers
    effect: Values


@dataclass(frozen=True)
class Reactions:
    """Heed of each type."""

    follow: Response
    yielding: Response
    cut_in: Response


@dataclass(frozen=True)
class PairLabels:
    """Types of ordered pairs as indices into `LANE_CHANGING`, and the effect on the receiver, or of it [m/s²]."""

    types: Int[np.ndarray, "S E T"]
    effect: Float[np.ndarray, "S E T"]


def by_rule(told: DriverRecords) -> Reactions:
    """Reactions without any intervention.

    A vehicle follows its leader where its model binds it: it allows less than the free speed, and the vehicle is no
    slower than that. It yields to who asks it where it is slower than its model and its own imperfection explain; where
    nobody asks, it may follow its target already (`_adapting`). It cuts in where its lane change leaves less than the
    secure gap and `ROOM`.
    """
    lowest = np.maximum(told.v - HARDEST * told.dt, 0.0)
    effect = (np.minimum(np.maximum(told.behind, lowest), told.free) - told.free) / told.dt
    short = _short(told)
    bound = (told.leader != NOBODY) & (effect < FELT) & (short >= 0)
    slowed = (told.asker != NOBODY) & (short < 0)
    adapting = _adapting(told, short) & (told.asker == NOBODY)
    follow = _follow(told, bound, effect, adapting, short)
    yielding = Response(np.where(slowed, told.asker, NOBODY), np.where(slowed, short - SLACK, 0.0))
    cut = np.where(told.room < ROOM, told.cut, NOBODY)
    return _with_changes(told, follow, yielding, cut)


def by_intervention(told: DriverRecords, unled: Values, unasked: Values) -> Reactions:
    """Reactions from the accelerations (now minus without) of vehicles that ignore their leader, or all requests.

    No intervention shows in one step what a vehicle does for its own lane change: `_adapting` is a rule here too.
    """
    bound = (told.leader != NOBODY) & (unled < FELT)
    slowed = (told.asker != NOBODY) & (unasked < FELT)
    short = _short(told)
    follow = _follow(told, bound, unled, _adapting(told, short) & ~slowed, short)
    yielding = Response(np.where(slowed, told.asker, NOBODY), np.where(slowed, unasked, 0.0))
    return _with_changes(told, follow, yielding, None)


def _short(told: DriverRecords) -> Values:
    """By how much a vehicle is slower (negative) than its model and its own imperfection explain [m/s²]."""
    lowest = np.maximum(told.v - HARDEST * told.dt, 0.0)
    allowed = np.maximum(np.minimum(told.behind, told.free), lowest)
    return (told.v_next - allowed) / told.dt + told.noise + SLACK


def _adapting(told: DriverRecords, short: Values) -> Flags:
    """Where a vehicle is held by its target, whom it will drive behind: slower than its own leader explains, and no
    slower than its model would allow behind the target.
    """
    least = (told.v_next - told.beside) / told.dt + told.noise + SLACK
    return (told.target != NOBODY) & (short < 0) & (least >= 0)


def _follow(told: DriverRecords, bound: Flags, effect: Values, adapting: Flags, short: Values) -> Response:
    """Towards the leader, or else the target."""
    adapting = adapting & ~bound
    whom = np.where(bound, told.leader, np.where(adapting, told.target, NOBODY))
    return Response(whom, np.where(bound, effect, np.where(adapting, short - SLACK, 0.0)))


def _with_changes(told: DriverRecords, follow: Response, yielding: Response, cut: Numbers | None) -> Reactions:
    """Add what lane changes do: they are instant, so their labels are kept for `HOLD`.

    Without `cut`, a change cuts in on whom the interventions show to feel it.
    """
    hold = told.steps(HOLD)
    helped = _held(np.where(told.gave_way, told.asker, NOBODY), hold)
    moved_over = (yielding.whom == NOBODY) & (helped != NOBODY)
    yielding = Response(np.where(moved_over, helped, yielding.whom), yielding.effect)
    return Reactions(follow, yielding, _cut_ins(told, follow, cut, hold))


def _cut_ins(told: DriverRecords, follow: Response, cut: Numbers | None, hold: int) -> Response:
    whom, effect = np.full_like(told.cut, NOBODY), np.zeros_like(told.v)
    for scene, j, t in np.argwhere((told.cut if cut is None else cut) != NOBODY).tolist():
        felt = _felt(told, follow, scene, j, t)
        if cut is not None or felt < CUT:
            whom[scene, j, t : t + hold] = told.cut[scene, j, t]
            effect[scene, j, t : t + hold] = felt
    return Response(whom, effect)


def _felt(told: DriverRecords, follow: Response, scene: int, j: int, t: int) -> float:
    """Greatest effect of vehicle j, within `FEEL` of its change at t, on who it came to drive before."""
    behind = np.flatnonzero(told.vehicle[scene] == told.cut[scene, j, t])
    after = slice(t, t + told.steps(FEEL))
    heeds = follow.whom[scene, behind, after] == told.vehicle[scene, j]
    return float(np.where(heeds, follow.effect[scene, behind, after], 0.0).min(initial=0.0))


def _held(whom: Numbers, hold: int) -> Numbers:
    """The same, with every number kept for so many steps."""
    held = whom.copy()
    for later in range(1, min(hold, whom.shape[-1])):
        shifted = np.full_like(whom, NOBODY)
        shifted[..., later:] = whom[..., :-later]
        held = np.where(held == NOBODY, shifted, held)
    return held


def pair_labels(reactions: Reactions, vehicle: Int[np.ndarray, "S N"]) -> PairLabels:
    """Labels of all ordered pairs; cutting in goes before yielding, yielding before following."""
    ordered = (FOLLOW, reactions.follow), (YIELD, reactions.yielding), (CUT_IN, reactions.cut_in)
    types, effects = [], []
    for i, j in pairs(vehicle.shape[1]):
        type_, effect = np.zeros_like(reactions.follow.whom[:, j]), np.zeros_like(reactions.follow.effect[:, j])
        for index, heed in ordered:
            concerned = heed.whom[:, j] == vehicle[:, i, None]
            type_, effect = np.where(concerned, index, type_), np.where(concerned, heed.effect[:, j], effect)
        types.append(type_)
        effects.append(effect)
    return PairLabels(np.stack(types, 1), np.stack(effects, 1))


class Reduction(StrEnum):
    """How the labels of a scene's steps become one graph that does not change."""

    STRONGEST = "strongest"
    """The interaction with the strongest effect at any step, the longer one where they are equal."""
    LONGEST = "longest"
    """What is there for most of the steps, none included."""


def reduced(
    labels: PairLabels, how: Reduction, clear_steps: int
) -> tuple[Int[np.ndarray, "S E"], Bool[np.ndarray, "S E"]]:
    """One type per pair, and whether it is unambiguous.

    It is where the pair never interacts, or interacts in one way only, for `clear_steps` in sum or more.
    """
    kinds = np.arange(len(LANE_CHANGING))
    there = labels.types[..., None] == kinds  # Shape: (S, E, T, K)
    steps = there.sum(2)
    if how is Reduction.LONGEST:
        chosen = steps.argmax(-1)
    else:
        strength = np.where(there, np.abs(labels.effect)[..., None], 0.0).max(2, initial=0.0)
        present = steps > 0
        present[..., NONE] = False
        score = np.where(present, 1.0 + strength + 1e-6 * steps, 0.0)
        chosen = score.argmax(-1)  # none, which comes first, where nothing is present
    interactions = (steps[..., 1:] > 0).sum(-1)
    lasting = steps[..., 1:].sum(-1) >= clear_steps
    return chosen, (interactions == 0) | ((interactions == 1) & lasting)
