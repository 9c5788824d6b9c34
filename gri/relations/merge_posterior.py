"""The probability of each relation in each step of a merge, without labels.

The explanations of `gri.relations.merge_explanations` are the states of a hidden Markov chain per driver
(`gri.relations.hidden_markov`). The chain is solved for every headway and standstill gap of a grid; the results are
weighted by their evidence. What drivers have in common is learned by maximising the evidence (`learn_constants`).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri.core.edges import LANE_CHANGING, EdgeType, pairs
from gri.progress import Progress, no_progress
from gri.relations.hidden_markov import log_evidence, smooth
from gri.relations.merge_explanations import (
    ALL_TERMS,
    CONSTANTS,
    FOLLOW,
    MERGER,
    Terms,
    driver_grid,
    explain,
    following_goal,
)
from gri.relations.merge_motion import MergeMotion, motion_of

CUT_IN_EFFECT = -0.5  # [m/s²]; a lane change that costs the lag vehicle less is no cut-in
CUT_IN_WINDOW, CUT_IN_HOLD = 2.0, 1.0  # [s]: where an effect is looked for, and how long a cut-in is one
SHORTEST = 0.6  # [s], of a relation that counts for the graph of a scene
AT_ONCE = 24  # scenes; bounds the memory
LEAST_NOISE = {"keep_noise": 0.08, "follow_noise": 0.1, "outsider_noise": 0.1, "adapt_noise": 0.1}
"""[m/s²]; simulated drivers sometimes repeat an acceleration exactly, and a density must not grow without bounds."""
NONE, FOLLOWS, YIELDS, CUTS_IN = (
    LANE_CHANGING.index(kind) for kind in (EdgeType.NONE, EdgeType.FOLLOW, EdgeType.YIELD, EdgeType.CUT_IN)
)


@dataclass(frozen=True)
class Driver:
    """What is found about the drivers of S scenes."""

    explanation: Float[Tensor, "S N G T K"]
    """P(explanation | headway, standstill gap, motion)."""
    weight: Float[Tensor, "S N G"]
    """P(headway, standstill gap | motion)."""


def relations_per_step(
    state: Float[Tensor, "S N T D"],
    lane_width: float | Float[Tensor, " S"],
    dt: float,
    length: Float[Tensor, "S N"] | None = None,
    constants: Mapping[str, float] = CONSTANTS,
    terms: Terms = ALL_TERMS,
) -> Float[Tensor, "S T E K"]:
    """Probabilities of none, follow, yield and cut_in (`gri.core.edges.LANE_CHANGING`) for all ordered pairs.

    All T steps are seen, also those after a step.

    Args:
        state: x, y, v and perhaps more [m, m, m/s]. Vehicle 0 is the one that may change lanes.
        lane_width: distance between the centres of two lanes [m].
        length: of the vehicles [m]; 5 m where 0 or not given.
        constants: as found by `learn_constants`.

    Raises:
        ValueError: numbers that are not finite, or fewer than three steps.
    """
    return relations(motion_of(state, lane_width, dt, length), constants, terms)


@torch.no_grad()
def relations(
    motion: MergeMotion,
    constants: Mapping[str, float] = CONSTANTS,
    terms: Terms = ALL_TERMS,
    unfinished: bool = False,
) -> Float[Tensor, "S T E K"]:
    """As `relations_per_step`, from motion; an `unfinished` one goes on after the last step.

    Then nobody knows yet how the lag vehicle reacts to a lane change. It counts as a cut-in if its driver would have to
    brake as a follower.
    """
    values = {name: torch.tensor(value, dtype=torch.float64) for name, value in constants.items()}
    parts = [motion[start : start + AT_ONCE] for start in range(0, len(motion), AT_ONCE)]
    return torch.cat([_relations(part, values, terms, unfinished) for part in parts])


def _relations(
    motion: MergeMotion, c: Mapping[str, Tensor], terms: Terms, unfinished: bool
) -> Float[Tensor, "S T E K"]:
    likelihood, prior = explain(motion, c, terms)
    chain = smooth(likelihood, prior, terms.stay)
    drivers = Driver(chain.marginals, chain.evidence.softmax(-1))
    n = motion.x.shape[1]
    mean = torch.einsum("sngtk,sng->sntk", drivers.explanation, drivers.weight)
    found = torch.zeros(len(motion), motion.x.shape[-1], n * (n - 1), len(LANE_CHANGING), dtype=torch.float64)
    for edge, (i, j) in enumerate(pairs(n)):
        found[:, :, edge, FOLLOWS] = mean[:, j, :, FOLLOW + i]
        found[:, :, edge, YIELDS] = mean[:, j, :, FOLLOW + n + i]
        if j == MERGER:
            cuts_in = _cut_in(motion, i, drivers, c, terms, unfinished)
            found[:, :, edge] *= 1 - cuts_in[..., None]
            found[:, :, edge, CUTS_IN] = cuts_in
    found[..., NONE] = (1 - found[..., 1:].sum(-1)).clamp(min=0)
    return found


def _cut_in(
    motion: MergeMotion, lag: int, drivers: Driver, c: Mapping[str, Tensor], terms: Terms, unfinished: bool
) -> Float[Tensor, "S T"]:
    """P(the merging vehicle cuts in on `lag`): within 2 s of its lane change, `lag` follows it and pays for that."""
    goal = following_goal(motion, lag, MERGER, c, driver_grid(terms))
    effect = goal.clamp(max=c["acceleration"]).maximum(-c["braking"]) - c["acceleration"]
    follows = torch.ones_like(effect) if unfinished else drivers.explanation[:, lag, :, :, FOLLOW + MERGER]
    pays = follows * (effect < CUT_IN_EFFECT)
    p = torch.einsum("sgt,sg->st", pays, drivers.weight[:, lag])
    behind = (motion.x[:, MERGER] > motion.x[:, lag]) & motion.same_lane(MERGER, lag)
    if not terms.derived_cut_in:
        p = torch.where(motion.next_to_each_other(lag, MERGER), 1.0, 0.0)
    window, hold = round(CUT_IN_WINDOW / motion.dt), round(CUT_IN_HOLD / motion.dt)
    found = torch.zeros_like(p)
    changed = motion.lane[:, MERGER, 1:] != motion.lane[:, MERGER, :-1]
    for scene, t in torch.nonzero(changed & behind[:, 1:]).tolist():
        found[scene, t + 1 : t + 1 + hold] = p[scene, t + 1 : t + 1 + window].max()
    return found


def scene_graphs(
    steps: Float[Tensor, "S T E K"], motion: MergeMotion, constants: Mapping[str, float] = CONSTANTS
) -> Int[Tensor, "S E"]:
    """One relation per pair: the one with the strongest effect in any step in which it is the most probable one.

    Relations that hold for less than 0.6 s are left out, as single steps are often wrong. An effect is what a driver's
    acceleration lacks to the greatest one. A cut-in acts on the lag vehicle.
    """
    answer = steps.argmax(-1)
    lacks = (constants["acceleration"] - motion.a).clamp(min=0.0)  # Shape: (S, N, T)
    window = round(CUT_IN_WINDOW / motion.dt)
    later = torch.nn.functional.pad(lacks, (0, window - 1)).unfold(-1, window, 1).amax(-1)
    found = torch.zeros_like(answer[:, 0])
    for edge, (i, j) in enumerate(pairs(motion.x.shape[1])):
        strength = torch.stack([lacks[:, j], lacks[:, j], later[:, i]], -1)  # of follow, yield, cut_in
        holds = answer[:, :, edge, None] == torch.arange(1, len(LANE_CHANGING))
        long = holds.sum(1) * motion.dt >= SHORTEST - 1e-9
        most = torch.where(holds & long[:, None], 1.0 + strength, 0.0).amax(1) + 1e-6 * holds.sum(1)
        found[:, edge] = torch.cat([torch.full_like(most[:, :1], 0.5), most], -1).argmax(-1)
    return found


def learn_constants(
    motion: MergeMotion,
    start: Mapping[str, float] = CONSTANTS,
    terms: Terms = ALL_TERMS,
    updates: int = 80,
    batch: int = 16,
    rate: float = 0.08,
    seed: int = 0,
    progress: Progress = no_progress,
) -> tuple[dict[str, float], float]:
    """What the drivers have in common, by maximum likelihood of their motion; and that likelihood [nats per step].

    Adam on random batches of scenes, on logarithms (`persistence` on its logit). No label is used.
    """
    floors = {name: LEAST_NOISE.get(name, 0.0) for name in start}
    free = {
        name: torch.tensor(value - floors[name], dtype=torch.float64).clamp(min=0.02) for name, value in start.items()
    }
    raw = {name: (v.logit() if name == "persistence" else v.log()).requires_grad_() for name, v in free.items()}
    optimiser = torch.optim.Adam(list(raw.values()), rate, betas=(0.8, 0.95))
    schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda k: min(1.0, 2 * (1 - k / max(updates, 1))))
    generator = torch.Generator().manual_seed(seed)

    def values() -> dict[str, Tensor]:
        return {n: v.sigmoid() if n == "persistence" else v.exp() + floors[n] for n, v in raw.items()}

    for done in range(updates):
        progress("driver constants", done, updates, 0.0)
        rows = torch.randperm(len(motion), generator=generator)[:batch]
        loss = -evidence(motion[rows], values(), terms)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    with torch.no_grad():
        learned = values()
        parts = [motion[k : k + AT_ONCE] for k in range(0, len(motion), AT_ONCE)]
        whole = sum(float(evidence(part, learned, terms)) * len(part) for part in parts) / len(motion)
    return {name: float(value) for name, value in learned.items()}, whole


def evidence(motion: MergeMotion, constants: Mapping[str, Tensor], terms: Terms) -> Tensor:
    """Mean log likelihood of an acceleration, averaged over headways and standstill gaps [nats]."""
    likelihood, prior = explain(motion, constants, terms)
    found = log_evidence(likelihood, prior, terms.stay)
    return (found.logsumexp(-1) - torch.tensor(float(found.shape[-1])).log()).mean() / (likelihood.shape[-2] - 1)
