"""Which parameters of the traffic matter: elementary effects of Morris, with the mean of Campolongo et al.

M. D. Morris (1991), Technometrics 33, 161–174; F. Campolongo, J. Cariboni, A. Saltelli (2007), Environmental Modelling
& Software 22, 1509–1518. A path through the parameters' ranges changes one parameter after the other by a fixed step.
The change of the result over the change of the parameter (in units of its range) is an elementary effect. `mu_star`,
the mean of its absolute values over paths, says how much a parameter matters; `sigma`, their spread, how much that
depends on the others. Noise adds to both. So there is a row for the noise: the same settings under other seeds.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

LEVELS = 4
STEP = LEVELS / (2 * (LEVELS - 1))  # of the range of a parameter: 2/3


@dataclass(frozen=True)
class Effect:
    """What a parameter does to one result: mean of the absolute and of the signed effects, and their spread."""

    parameter: str
    mu_star: float
    mu: float
    sigma: float


def paths(parameters: int, number: int, rng: np.random.Generator) -> Float[np.ndarray, "paths points parameters"]:
    """Points between 0 and 1: each path has one point more than parameters, and changes each of them once by STEP."""
    found = np.empty((number, parameters + 1, parameters))
    low = np.arange(LEVELS // 2) / (LEVELS - 1)
    for path in found:
        start, up = rng.choice(low, parameters), rng.random(parameters) < 0.5
        path[0] = np.where(up, start, start + STEP)
        for k, parameter in enumerate(rng.permutation(parameters)):
            path[k + 1] = path[k]
            path[k + 1, parameter] += STEP if up[parameter] else -STEP
    return found


def effects(
    names: Sequence[str],
    points: Float[np.ndarray, "paths points parameters"],
    results: Float[np.ndarray, "paths points"],
) -> list[Effect]:
    """The effects of all parameters, the strongest first; results that are NaN count for nothing."""
    moved = np.diff(points, axis=1)
    which = np.abs(moved).argmax(-1)
    slopes = np.diff(results, axis=1) / np.take_along_axis(moved, which[..., None], -1)[..., 0]
    found = []
    for k, name in enumerate(names):
        own = slopes[(which == k) & np.isfinite(slopes)]
        spread = float(own.std(ddof=1)) if len(own) > 1 else np.nan
        found.append(Effect(name, float(np.abs(own).mean()), float(own.mean()), spread) if len(own) else _unknown(name))
    return sorted(found, key=lambda effect: -np.nan_to_num(effect.mu_star))


def _unknown(name: str) -> Effect:
    return Effect(name, np.nan, np.nan, np.nan)


def scaled(initial: Sequence[float], change: float, point: Float[np.ndarray, " parameters"]) -> tuple[float, ...]:
    """Values of the parameters at a point between 0 and 1: within ±`change` of the initial ones."""
    factors = 1 - change + 2 * change * point
    return tuple(float(value) for value in np.round(np.array(initial) * factors, 4))
