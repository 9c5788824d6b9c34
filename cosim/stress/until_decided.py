"""Going on with a stress test, seed by seed, until it is decided which of two policies is better."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from cosim.measures.sequential_test import Decision, decide
from cosim.stress.plan import Cell, Chunk
from cosim.stress.stress_test import Computation, Tell, Warn, run_stress
from gri.errors import InputError

STARTS_PER_SEED = 2  # few, because the evidence grows with the number of seeds; more than one shares the warm-up


@dataclass(frozen=True)
class Contest:
    """Two policies, the cell in which they are compared, and the probability of a wrong decision."""

    a: str
    b: str
    cell: Cell
    error: float


def contest_of(text: str, policies: Sequence[str], sweeps: dict[str, tuple[float, ...]], error: float) -> Contest:
    """The contest "A:B" in the only cell of the sweeps. Raises `InputError` for other policies or several cells."""
    names = text.split(":")
    if len(set(names)) != 2 or not set(names) <= set(policies):
        raise InputError(f"--until-decided: got {text!r}, expected two of {', '.join(policies)}, as in A:B")
    cells = [Cell(kind, intensity) for kind, intensities in sweeps.items() for intensity in intensities]
    if len(cells) != 1:
        raise InputError(
            f"--until-decided: got {len(cells)} intensities, expected one; name it with --perturbation and --intensity"
        )
    return Contest(names[0], names[1], cells[0], error)


def run_until_decided(
    chunks: Sequence[Chunk],
    contest: Contest,
    folder: Path,
    workers: int,
    tell: Tell,
    warn: Warn = lambda text: None,
) -> tuple[Sequence[Chunk], pd.DataFrame, Computation, Decision]:
    """Run the chunks, as many seeds at a time as there are workers, until the contest is decided or all are done.

    Returns the chunks that were run, their rows, how they were computed, and the decision.
    """
    seeds = list(dict.fromkeys(chunk.scenario.seed for chunk in chunks))
    most = sum(chunk.starts for chunk in chunks)
    for end in range(workers, len(seeds) + workers, workers):
        begun = [chunk for chunk in chunks if chunk.scenario.seed in seeds[:end]]
        rows, computation = run_stress(begun, folder, workers, lambda stage, done, _: tell(stage, done, most), warn)
        decision = decide(seed_differences(rows, contest), contest.error)
        if decision.better:
            break
    return begun, rows, computation, decision


def seed_differences(rows: pd.DataFrame, contest: Contest) -> np.ndarray:
    """Share of feasible starts that a completes without contact, minus that of b; one number per seed, in order.

    A seed without a feasible start has none.
    """
    same = (rows["perturbation"] == contest.cell.perturbation) & (rows["intensity"] == contest.cell.intensity)
    feasible = rows[same & (rows["infeasible"] == "")]
    outcome = feasible.assign(good=feasible["completed_without_contact"].astype(float))
    shares = outcome.groupby(["seed", "policy"])["good"].mean().unstack()
    return (shares[contest.a] - shares[contest.b]).to_numpy() if len(shares) else np.array([])


def sentence(contest: Contest, decision: Decision) -> str:
    """What was decided, by which evidence, and what the p-values of the same rows are worth."""
    where = f"{contest.cell.perturbation} {contest.cell.intensity:g}"
    evidence = f"e-value {decision.e_value:.1f}, needed {1 / contest.error:g}"
    difference = f"mean difference of the seeds {100 * decision.mean_difference:+.0f} points"
    if decision.better:
        better, worse = (contest.a, contest.b) if decision.better > 0 else (contest.b, contest.a)
        found = f"Decided after {decision.clusters} seeds: {better} completes more drives without contact than {worse}"
    else:
        found = f"Not decided after {decision.clusters} seeds: {contest.a} and {contest.b} may be equal"
    return (
        f"{found} ({where}; {contest.a} − {contest.b}: {difference}; {evidence}). Equal policies are told apart with a"
        f" probability of at most {100 * contest.error:g} %, although this test is looked at after every seed. The"
        " intervals, p-values and stars of the tables do not hold after such stopping."
    )
