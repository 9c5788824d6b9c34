"""Chunks in real traffic: the same starts for all policies, and no branch disturbs another."""

import pandas as pd
import pytest
from msgspec.structs import replace

from cosim.process.fork import CAN_FORK
from cosim.spec.scenario import ConstantVelocity, Idm, LeftToSumo
from cosim.stress import chunk as chunk_module
from cosim.stress.chunk import chunk_rows, stress_chunk
from cosim.stress.plan import NOMINAL, chunks

pytestmark = pytest.mark.skipif(not CAN_FORK, reason="stress tests fork")
POLICIES = {"idm": Idm(), "constant_velocity": ConstantVelocity(), "sumo": LeftToSumo()}
SWEEPS = {"headway_ratio": (0.3, 1.5), "leader_braking": (8.0,), "neighbour_cut_in": (1.0,)}


def quiet(*_: object) -> None:
    """Ignores progress."""


@pytest.fixture(scope="module")
def chunk(short_scenario):
    (chunk,) = chunks(replace(short_scenario, horizon=6.0), POLICIES, SWEEPS, starts=3)
    return chunk


@pytest.fixture(scope="module")
def rows(chunk) -> pd.DataFrame:
    return pd.DataFrame(chunk_rows(chunk, quiet)[0])


def test_every_policy_drives_every_start_in_every_cell(rows):
    starts = rows.groupby(["perturbation", "intensity", "policy"], dropna=False)["start"].agg(["nunique", "size"])
    assert len(starts) == 5 * 3
    assert (starts == 3).all(axis=None)
    assert rows["start"].nunique() == 3


def test_feasibility_is_the_same_for_all_policies(rows):
    reasons = rows.groupby(["perturbation", "intensity", "start"], dropna=False)["infeasible"].nunique()
    assert (reasons == 1).all()
    ahead = rows[(rows["perturbation"] == "headway_ratio") & (rows["intensity"] == 1.5)]
    assert set(ahead["infeasible"]) <= {"order", "overlap"}


def test_a_policy_at_constant_velocity_runs_into_a_braking_leader(rows):
    blind = rows[(rows["perturbation"] == "leader_braking") & (rows["policy"] == "constant_velocity")]
    assert blind["contact"].all()
    assert blind["contact_with"].str.split(",").str[0].eq("1→2").all()
    assert not blind["completed_without_contact"].any()
    assert (blind["min_ttc"] == 0).all()
    braking = rows[(rows["perturbation"] == "leader_braking") & (rows["policy"] == "idm")]
    assert not braking["contact"].astype(bool).any()


def test_a_branch_does_not_disturb_another(chunk, rows):
    """A cell and a policy alone give the rows they give among all the others."""
    alone = pd.DataFrame(chunk_rows(replace(chunk, cells=chunk.cells[-1:], policies={"idm": Idm()}), quiet)[0])
    among = rows[(rows["perturbation"] == "neighbour_cut_in") & (rows["policy"] == "idm")].reset_index(drop=True)
    pd.testing.assert_frame_equal(alone, among[alone.columns], check_exact=True, check_dtype=False)


def test_undisturbed_episodes_alone_are_written_as_those_among_others(chunk, tmp_path, monkeypatch):
    """Their intensity is missing, which must not make it a column of another type."""
    alone = replace(chunk, cells=chunk.cells[:1], policies={"idm": Idm()})
    row = {"policy": "idm", "perturbation": NOMINAL, "intensity": None}
    monkeypatch.setattr(chunk_module, "chunk_rows", lambda *_: ([row], []))
    stress_chunk(alone, {alone.key: tmp_path / "part.parquet"}, {}, quiet)
    assert pd.read_parquet(tmp_path / "part.parquet")["intensity"].dtype == float


def test_perturbed_traffic(short_scenario):
    _, chunk = chunks(replace(short_scenario, horizon=2.0), {"idm": Idm()}, {"low_friction": (0.3,)}, starts=2)
    rows = pd.DataFrame(chunk_rows(chunk, quiet)[0])
    assert set(rows["perturbation"]) == {"low_friction"}
    assert (rows["min_acceleration"] >= -0.3 * 9.81 - 1e-6).all()
