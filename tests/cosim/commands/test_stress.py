"""`cosim stress` as a person uses it."""

import json
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from cosim.process.fork import CAN_FORK
from tests.cosim.conftest import write_short

pytestmark = pytest.mark.skipif(not CAN_FORK, reason="stress tests fork")
OPTIONS = ("--policy", "idm,sumo", "--perturbation", "headway_ratio", "--intensity", "0.2,0.5", "--starts", "2")


def stress(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "cosim", "stress", *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=600)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("stress")
    write_short(folder / "short.yaml")
    return folder


@pytest.mark.slow
def test_a_stress_test_ends_with_tables_and_figures_and_goes_on_where_it_stopped(folder):
    done = stress("short.yaml", *OPTIONS, "--out", "out", cwd=folder)
    assert done.returncode == 0, done.stderr
    names = {path.name for path in (folder / "out").iterdir()}
    assert names == {
        "chunks", "figures", "stress.md", "stress.html", "stress.json",
        "episodes.parquet", "counts.parquet", "estimates.parquet", "differences.parquet", "effects.parquet",
        "counts.csv", "estimates.csv", "differences.csv", "effects.csv",
    }  # fmt: skip
    assert {path.name for path in (folder / "out/figures").iterdir()} == {"headway_ratio.png", "headway_ratio.svg"}
    rows = pd.read_parquet(folder / "out/episodes.parquet")
    assert len(rows) == 2 * 3 * 2
    report = (folder / "out/stress.md").read_text()
    assert "| 0.2 | idm |" in report
    facts = json.loads((folder / "out/stress.json").read_text())
    assert facts["command"].startswith("cosim stress short.yaml --policy idm,sumo")
    assert facts["worker_seconds"] > 0
    assert len(facts["commits"]) == 1
    made = {path: path.stat().st_mtime_ns for path in (folder / "out/chunks").glob("*.parquet")}
    assert len(made) == 2 * 2  # kinds, the undisturbed one among them, and policies
    again = stress("short.yaml", *OPTIONS, "--out", "out", cwd=folder)
    assert again.returncode == 0, again.stderr
    pd.testing.assert_frame_equal(pd.read_parquet(folder / "out/episodes.parquet"), rows, check_exact=True)
    more = stress("short.yaml", *OPTIONS, "--policy", "idm,sumo,constant_velocity", "--out", "out", cwd=folder)
    assert more.returncode == 0, more.stderr
    both = pd.read_parquet(folder / "out/episodes.parquet")
    assert len(both) == 2 * 3 * 3
    known = both[both["policy"] != "constant_velocity"].reset_index(drop=True)
    pd.testing.assert_frame_equal(known[rows.columns], rows, check_exact=True)
    assert made.items() <= {path: path.stat().st_mtime_ns for path in (folder / "out/chunks").glob("*.parquet")}.items()


def test_bad_options_are_refused(folder):
    for options, message in (
        (("--perturbation", "fog"), "unknown kind 'fog'"),
        (("--intensity", "much"), "expected numbers"),
        (("--policy", "nobody"), "no checkpoint 'nobody'"),
    ):
        done = stress("short.yaml", *options, cwd=folder)
        assert done.returncode == 2
        assert message in done.stderr
        assert "Traceback" not in done.stderr
