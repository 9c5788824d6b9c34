"""What may explain a driver's acceleration in one step of a merge, and how well it does.

One driver has one explanation at a time:

- *own*: it accelerates freely, or keeps its speed.
- *outsider*: it reacts to a vehicle that is not in the scene. Its acceleration goes on much as before.
- *follow k*: k is the next vehicle ahead in its lane, and the speed that is safe behind k is less than it could reach.
  Or it wants to change to k's lane and falls back behind k, its *target*.
- *yield to k*: k wants to change to its lane and lacks room there. It brakes, goes on braking, or holds its speed.

The safe speed is Gipps': a driver stays able to stop behind a leader that brakes as hard as itself,
v_safe = −bτ + √(b²τ² + v_k² + 2b (gap − s₀)). It binds from one side only: a driver far behind is not following.
Headway τ and standstill gap s₀ differ between drivers and are not known; likelihoods come for a grid of both.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import log, pi

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gri.relations.hidden_markov import IMPOSSIBLE
from gri.relations.merge_motion import MergeMotion

OWN, OUTSIDER, FOLLOW = 0, 1, 2
"""Places of the explanations: FOLLOW + k is "follow k", FOLLOW + N + k is "yield to k"."""
MERGER = 0
BINDING = 0.1  # [m/s²]; a leader that costs less does not bind

CONSTANTS: dict[str, float] = {
    "braking": 3.0,  # b: of a driver that must stop; no driver brakes harder [m/s²]
    "relaxation": 0.4,  # time in which a driver goes to its safe speed [s]
    "acceleration": 1.7,  # greatest one [m/s²]
    "slack": 0.3,  # by how much drivers stay below what they could do, on average [m/s²]
    "follow_noise": 0.35,  # [m/s²], as all that follow
    "keep_noise": 0.25,  # of a driver that keeps its wished speed
    "persistence": 0.8,  # of an outsider's effect, from step to step
    "outsider_noise": 0.5,
    "adapt_rate": 1.5,  # with which a driver falls back behind its target
    "adapt_noise": 0.4,
    "restrained": 0.8,  # acceleration of a slow driver that stays behind its target
}
"""What the drivers of a data set have in common, where learning begins."""


@dataclass(frozen=True)
class Terms:
    """Parts of the model. Each can be left out, to see what it brings."""

    one_sided: bool = True
    """Following only where the safe speed binds. Else following is a goal that also asks a driver to catch up."""
    latent_driver: bool = True
    """Headway and standstill gap of each driver are unknown. Else all drivers have those of `MEAN_DRIVER`."""
    keep: bool = True
    """Free drivers may keep their speed. Else they accelerate."""
    outsider: bool = True
    adapt: bool = True
    """A driver that wants to change lanes may brake for its target before the safe speed binds."""
    hold: bool = True
    """Drivers may yield by holding their speed."""
    steady: bool = True
    """Drivers may yield by braking on as before."""
    room: bool = True
    """Room is asked for only where the gap is shorter than a share of the safe one."""
    derived_cut_in: bool = True
    """Cut-ins follow from how the lag vehicle follows. Else every lane change ahead of a vehicle is one."""
    motion: bool = True
    """Accelerations count. Else only who is where, and how fast: the prior alone."""
    stay: float = 0.9
    """Probability that an explanation holds in the next step, too."""


ALL_TERMS = Terms()
MEAN_DRIVER = (1.4, 2.0)  # headway [s], standstill gap [m]
HEADWAYS = torch.linspace(0.4, 2.4, 38, dtype=torch.float64)  # [s]
STANDSTILL_GAPS = torch.linspace(1.1, 2.9, 6, dtype=torch.float64)  # [m]
ROOM = 0.3  # a merging vehicle asks for room where the gap is shorter than this share of the safe one

ODDS: dict[str, float] = {
    "own": 0.7,
    "outsider": 0.6,
    "leader": 3.0,
    "target": 3.0,
    "yield": 2.0,
    "let pass": 2.0,
}
"""Prior odds of explanations that are possible in a step, set by hand. Learned odds drift: "outsider" swallows all."""


def driver_grid(terms: Terms) -> tuple[Float[Tensor, " G"], Float[Tensor, " G"]]:
    """Headways [s] and standstill gaps [m] over which each driver's likelihood is averaged."""
    if not terms.latent_driver:
        headway, standstill = (torch.tensor([value], dtype=torch.float64) for value in MEAN_DRIVER)
        return headway, standstill
    headway, standstill = torch.cartesian_prod(HEADWAYS, STANDSTILL_GAPS).unbind(-1)
    return headway, standstill


def safe_speed(gap: Tensor, v_ahead: Tensor, headway: Tensor | float, braking: Tensor | float) -> Tensor:
    """The speed from which a driver can still stop [m/s]; `gap` without the standstill gap [m]."""
    reach = braking * headway
    return (reach**2 + v_ahead**2 + 2 * braking * gap).clamp(min=1e-3).sqrt() - reach


def lacks_room(gap: Tensor, v: Tensor, v_ahead: Tensor, braking: Tensor) -> Bool[Tensor, "S T"]:
    """Whether a gap [m] is shorter than a share of the one that is safe at speeds v and v_ahead [m/s]."""
    headway, standstill = MEAN_DRIVER
    safe = (v * headway + (v**2 - v_ahead**2) / (2 * braking)).clamp(min=1.0)
    return gap - standstill < ROOM * safe


def explain(
    motion: MergeMotion, constants: Mapping[str, Tensor], terms: Terms
) -> tuple[Float[Tensor, "S N G T K"], Float[Tensor, "S N G T K"]]:
    """Log likelihood of every driver's acceleration in every step, and log prior of each explanation."""
    likelihood, prior = [], []
    for j in range(motion.x.shape[1]):
        fits, odds = _explain_one(motion, j, constants, terms)
        likelihood.append(fits)
        prior.append(odds)
    fits, odds = torch.stack(likelihood, 1), torch.stack(prior, 1)
    share = odds / odds.sum(-1, keepdim=True)
    log_prior = torch.where(share > 0, share.clamp(min=1e-30).log(), IMPOSSIBLE)
    return fits, log_prior


def _explain_one(
    motion: MergeMotion, j: int, c: Mapping[str, Tensor], terms: Terms
) -> tuple[Float[Tensor, "S G T K"], Float[Tensor, "S G T K"]]:
    n, a = motion.x.shape[1], motion.a[:, j, None]
    before = torch.cat([a[..., :1], a[..., :-1]], -1)
    grid = driver_grid(terms)
    wide = torch.zeros(len(motion), len(grid[0]), a.shape[-1], dtype=a.dtype)
    one = torch.ones_like(a)
    fits = [_own(a, c, terms), _outsider(a, before, c)] + [torch.zeros_like(a)] * (2 * n)
    odds = [one * ODDS["own"], one * (ODDS["outsider"] if terms.outsider else 0.0)] + [torch.zeros_like(a)] * (2 * n)
    for k in range(n):
        if k == j:
            continue
        near, ahead = motion.next_to_each_other(j, k)[:, None], (motion.x[:, k] > motion.x[:, j])[:, None]
        same = motion.same_lane(j, k)[:, None]
        goal = following_goal(motion, j, k, c, grid)
        binds = goal < c["acceleration"] - BINDING if terms.one_sided else torch.ones_like(goal, dtype=torch.bool)
        leads = same & ahead & near
        follow = _follow(a, goal, c)
        follow_odds = ODDS["leader"] * leads
        if j == MERGER:
            target = ~same & ahead & near
            follow = torch.where(target, _adapt(a, follow, c), follow) if terms.adapt else follow
            binds = binds | target if terms.adapt else binds
            follow_odds = follow_odds + ODDS["target"] * target
        fits[FOLLOW + k] = follow
        odds[FOLLOW + k] = follow_odds * binds
        if k == MERGER:
            asked = _asked_for_room(motion, j, c, terms)
            fits[FOLLOW + n + k] = _yield(a, before, c, terms)
            odds[FOLLOW + n + k] = (~same & near) * torch.where(ahead, ODDS["yield"], ODDS["let pass"]) * asked[:, None]
    stacked = torch.stack([fit + wide for fit in fits], -1)
    judged = torch.full((a.shape[-1], 1), float(terms.motion), dtype=a.dtype)
    judged[-1] = 0  # no acceleration is known from the last step on
    return stacked * judged, torch.stack([odd + wide for odd in odds], -1)


def following_goal(
    motion: MergeMotion, j: int, k: int, c: Mapping[str, Tensor], grid: tuple[Tensor, Tensor]
) -> Float[Tensor, "S G T"]:
    """Acceleration [m/s²] with which driver j would go to its safe speed behind k; not limited above."""
    headway, standstill = grid[0][:, None], grid[1][:, None]
    safe = safe_speed(motion.gap(j, k)[:, None] - standstill, motion.v[:, k, None], headway, c["braking"])
    return (safe - motion.v[:, j, None]) / c["relaxation"]


def _asked_for_room(motion: MergeMotion, j: int, c: Mapping[str, Tensor], terms: Terms) -> Bool[Tensor, "S T"]:
    """Where the merging vehicle, in the next lane, asks j for room: j is behind it, or ahead and slower."""
    v, ahead = motion.v, motion.x[:, MERGER] > motion.x[:, j]
    slower = v[:, j] < v[:, MERGER]
    if not terms.room:
        return ahead | slower
    behind = lacks_room(motion.gap(j, MERGER), v[:, j], v[:, MERGER], c["braking"])
    in_front = lacks_room(motion.gap(MERGER, j), v[:, MERGER], v[:, j], c["braking"])
    return torch.where(ahead, behind, slower & in_front)


def _own(a: Tensor, c: Mapping[str, Tensor], terms: Terms) -> Tensor:
    keep = [(0.33, _normal(a, 0.0, c["keep_noise"]))] if terms.keep else []
    free = _normal(a, c["acceleration"] - c["slack"], c["follow_noise"])
    return _mixture([(0.65, free), *keep, (0.02, _normal(a, 0.0, 2.0))])


def _outsider(a: Tensor, before: Tensor, c: Mapping[str, Tensor]) -> Tensor:
    on = _normal(a, c["persistence"] * before, c["outsider_noise"])
    return _mixture([(0.88, on), (0.12, _normal(a, -0.5, 1.5))])


def _follow(a: Tensor, goal: Tensor, c: Mapping[str, Tensor]) -> Tensor:
    wanted = goal.clamp(max=c["acceleration"]).maximum(-c["braking"])
    return _mixture([(0.95, _normal(a, wanted - c["slack"], c["follow_noise"])), (0.05, _normal(a, wanted, 1.0))])


def _adapt(a: Tensor, follow: Tensor, c: Mapping[str, Tensor]) -> Tensor:
    """Falls back, speeds up less than it could, follows already, brakes as hard as it can, or brakes in any way."""
    falls_back, restrained = (_normal(a, mean, c["adapt_noise"]) for mean in (-c["adapt_rate"], c["restrained"]))
    slows = [(0.12, _hardest(a, c)), (0.08, _normal(a, -2.0, 1.0))]
    return _mixture([(0.35, falls_back), (0.2, restrained), (0.25, follow), *slows])


def _yield(a: Tensor, before: Tensor, c: Mapping[str, Tensor], terms: Terms) -> Tensor:
    """Brakes as hard as it can, brakes in any way, brakes on, or holds its speed."""
    slows = torch.nn.functional.logsigmoid(-a / 0.1)
    evenly = slows + torch.nn.functional.logsigmoid((a + c["braking"]) / 0.1) - c["braking"].log()
    parts = [(0.25, _hardest(a, c)), (0.2, evenly), (0.05, _normal(a, -1.0, 2.0))]
    parts += [(0.25, _normal(a, before, 0.06) + slows)] if terms.steady else []
    parts += [(0.25, _normal(a, 0.0, c["keep_noise"]))] if terms.hold else []
    whole = sum(weight for weight, _ in parts)
    return _mixture([(weight / whole, part) for weight, part in parts])


def _hardest(a: Tensor, c: Mapping[str, Tensor]) -> Tensor:
    return _normal(a, -c["braking"], 0.15)


def _mixture(parts: Sequence[tuple[float, Tensor]]) -> Tensor:
    return torch.stack(torch.broadcast_tensors(*(part + log(weight) for weight, part in parts))).logsumexp(0)


def _normal(x: Tensor, mean: Tensor | float, sd: Tensor | float) -> Tensor:
    sd = torch.as_tensor(sd, dtype=x.dtype)
    return -0.5 * ((x - mean) / sd) ** 2 - sd.log() - 0.5 * log(2 * pi)
