"""How soon inferred graphs follow relations that begin and end, and how often they change for nothing.

Truth and inference are edge types of ordered pairs over time, on the same steps; `none` is a type like any other.
Begin with `graph_changes`.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

HOLD = 1.0  # [s] for which a relation must be there, or not be there, before and after a change that counts
NEAR = 1.0  # [s] before a true change in which an inferred change is not false: labels and histories have edges too
Types = Int[np.ndarray, "P T"]


@dataclass(frozen=True)
class GraphChanges:
    """What became of the changes of P pairs.

    `new` and `ended` are the delays [s] of relations that begin and end; inf where the change was not noticed as long
    as it lasted. `anticipated` counts changes that the graph showed before they happened, which are no delays.
    `false_switches` are inferred changes per second and pair to what is not true within NEAR. `macro_f1` is the mean
    over the types that occur of F1 over all pairs and steps.
    """

    new: Float[np.ndarray, " A"]
    ended: Float[np.ndarray, " B"]
    anticipated: int
    false_switches: float
    macro_f1: float


def graph_changes(truth: Types, found: Types, none: int, dt: float) -> GraphChanges:
    """Compare inferred with true relations of P pairs at T steps of `dt` [s]; `none` is the type of no relation."""
    hold = max(round(HOLD / dt), 1)
    new: list[float] = []
    ended: list[float] = []
    anticipated = 0
    for true, seen in zip(truth != none, found != none, strict=True):
        for t in np.flatnonzero(true[1:] != true[:-1]) + 1:
            before, after = true[max(t - hold, 0) : t], true[t : t + hold]
            if len(before) < hold or len(after) < hold or (before != before[-1]).any() or (after != after[0]).any():
                continue
            if seen[t - 1] == true[t]:
                anticipated += 1
                continue
            until = next((k for k in range(t, len(true)) if true[k] != true[t]), len(true))
            noticed = np.flatnonzero(seen[t:until] == true[t])
            (new if true[t] else ended).append(float(noticed[0]) * dt if len(noticed) else np.inf)
    return GraphChanges(
        np.array(new),
        np.array(ended),
        anticipated,
        _false_switches(truth, found, round(NEAR / dt)) / max(found.size * dt, dt),
        macro_f1(truth, found),
    )


def _false_switches(truth: Types, found: Types, near: int) -> int:
    """The number of inferred changes to a type that is not the true one within `near` steps."""
    count = 0
    for p, t in zip(*np.nonzero(found[:, 1:] != found[:, :-1]), strict=True):
        around = truth[p, max(t + 1 - near, 0) : t + 2 + near]
        count += found[p, t + 1] not in around
    return count


def macro_f1(truth: Int[np.ndarray, "*batch"], found: Int[np.ndarray, "*batch"]) -> float:
    """The mean of the F1 scores of the types that occur in the truth."""
    scores = []
    for kind in np.unique(truth):
        both = ((truth == kind) & (found == kind)).sum()
        scores.append(2 * both / ((truth == kind).sum() + (found == kind).sum()))
    return float(np.mean(scores))


def smoothed_over_time(
    probs: Float[np.ndarray, "P W K"], every_s: float, window_s: float, switching_rate: float, weight: float = 1.0
) -> Float[np.ndarray, "P W K"]:
    """Inferences every `every_s` [s] combined as in closed loop: one hidden Markov chain per pair.

    Each inference sees the last `window_s`, so it counts as `every_s`/`window_s` of an observation, times `weight`
    (`cosim.loop.graph_source.smoothed` has 1, docs/decisions/058).
    """
    stay = np.exp(-switching_rate * every_s)
    evidence = min(every_s / window_s * weight, 1.0) * np.log(np.maximum(probs, 1e-9))
    found = [probs[:, 0]]
    for now in np.moveaxis(evidence[:, 1:], 1, 0):
        expected = stay * found[-1] + (1 - stay) / probs.shape[-1]
        logits = np.log(np.maximum(expected, 1e-9)) + now
        weights = np.exp(logits - logits.max(-1, keepdims=True))
        found.append(weights / weights.sum(-1, keepdims=True))
    return np.stack(found, 1)
