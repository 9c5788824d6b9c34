"""Going on until it is decided: where it stops, what it says, and what it refuses."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cosim.spec.scenario import ConstantVelocity, Idm
from cosim.stress import until_decided
from cosim.stress.plan import Cell, chunks
from cosim.stress.stress_test import Computation
from cosim.stress.until_decided import (
    STARTS_PER_SEED,
    Contest,
    contest_of,
    run_until_decided,
    seed_differences,
    sentence,
)
from gri.errors import InputError

BRAKING = Cell("leader_braking", 8.0)
CONTEST = Contest("idm", "still", BRAKING, 0.05)


def rows_of(seeds, good) -> pd.DataFrame:
    """Two starts a seed in a nominal and a braking cell; `good(policy, seed)` completes at braking."""
    return pd.DataFrame(
        [
            {"seed": seed, "start": f"{seed}/{k}", "policy": policy, "perturbation": kind, "intensity": intensity,
             "infeasible": "", "completed_without_contact": kind == "nominal" or good(policy, seed)}
            for seed in seeds
            for kind, intensity in (("nominal", np.nan), ("leader_braking", 8.0))
            for policy in ("idm", "still")
            for k in range(2)
        ]
    )  # fmt: skip


@pytest.fixture
def play(monkeypatch, short_scenario):
    """Runs a contest in which the stress test itself is replaced by `good`."""

    def play(good, starts=60, workers=2):
        planned = chunks(
            short_scenario,
            {"idm": Idm(), "still": ConstantVelocity()},
            {"leader_braking": (8.0,)},
            starts,
            STARTS_PER_SEED,
        )

        def run(parts, folder, workers, tell, warn=None):
            seeds = [chunk.scenario.seed for chunk in parts]
            tell("starts", 2 * len(seeds), 2 * len(seeds))
            return rows_of(seeds, good), Computation(0.0, [], pd.DataFrame())

        monkeypatch.setattr(until_decided, "run_stress", run)
        told = []
        found = run_until_decided(planned, CONTEST, Path(), workers, lambda *state: told.append(state))
        return planned, found, told

    return play


def test_a_clear_case_stops_early_and_names_the_better_one(play):
    planned, (begun, rows, _, decision), told = play(lambda policy, _: policy == "idm")
    assert decision.better == 1
    assert decision.clusters == 8, "the mean of (1 + λ)⁸/2 over the stakes is the first above 20"
    assert len(begun) == rows["seed"].nunique() == 8 < len(planned) == 30
    assert told[-1] == ("starts", 16, 60)
    text = sentence(CONTEST, decision)
    assert "Decided after 8 seeds: idm completes more drives without contact than still" in text
    assert "+100 points" in text
    _, (*_, other), _ = play(lambda policy, _: policy == "still")
    assert (other.better, other.clusters) == (-1, 8)


def test_the_decision_does_not_depend_on_the_number_of_workers(play):
    _, (begun, *_, decision), _ = play(lambda policy, _: policy == "idm", workers=5)
    assert len(begun) == 10
    assert decision.clusters == 8


def test_equal_policies_are_left_undecided_at_the_maximum(play):
    planned, (begun, _, _, decision), _ = play(lambda policy, seed: (seed % 2 == 0) == (policy == "idm"))
    assert decision.better == 0
    assert len(begun) == len(planned)
    assert "Not decided after 30 seeds: idm and still may be equal" in sentence(CONTEST, decision)


def test_only_feasible_starts_of_the_cell_count():
    rows = rows_of([1, 2, 3], lambda policy, seed: policy == "idm")
    rows.loc[rows["seed"] == 2, "infeasible"] = "overlap"
    assert seed_differences(rows, CONTEST).tolist() == [1.0, 1.0]
    assert seed_differences(rows.assign(infeasible="overlap"), CONTEST).size == 0


@pytest.mark.parametrize(
    ("text", "sweeps", "message"),
    [
        ("idm", {"leader_braking": (8.0,)}, "got 'idm', expected two of idm, still, as in A:B"),
        ("idm:gri", {"leader_braking": (8.0,)}, "got 'idm:gri', expected two of idm, still"),
        ("idm:idm", {"leader_braking": (8.0,)}, "expected two of"),
        ("idm:still", {"leader_braking": (4.0, 8.0)}, "got 2 intensities, expected one"),
    ],
)
def test_a_contest_has_two_policies_and_one_intensity(text, sweeps, message):
    with pytest.raises(InputError, match=message):
        contest_of(text, ["idm", "still"], sweeps, 0.05)
    assert contest_of("idm:still", ["idm", "still"], {"leader_braking": (8.0,)}, 0.05) == CONTEST
