"""The command as a person uses it: real runs in a subprocess, and every kind of bad input."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
import yaml

from cosim.commands.cli import main
from gri.resources import find_checkpoint
from tests.command_line import in_this_process
from tests.cosim.conftest import write_short


def cosim(*arguments: str, cwd: Path, timeout: float = 120) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "cosim", *arguments], cwd=cwd, capture_output=True, text=True, timeout=timeout
    )


@pytest.fixture(scope="module")
def short(tmp_path_factory) -> Path:
    """A folder with a short scenario."""
    folder = tmp_path_factory.mktemp("cli")
    write_short(folder / "short.yaml", episodes=4, watch=1.0)
    return folder


def variant(folder: Path, name: str, **changes) -> str:
    content = yaml.safe_load((folder / "short.yaml").read_text()) | changes
    (folder / name).write_text(yaml.safe_dump(content))
    return name


def here(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """The same without a process of its own, for what is refused before anything is imported."""
    return in_this_process(main, *arguments, cwd=cwd)


def refused(folder: Path, *arguments: str, command=cosim) -> str:
    """The one line a bad command gets, after checking that nothing was left behind."""
    before = set(folder.rglob("*"))
    done = command(*arguments, cwd=folder)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("error:")]
    assert len(lines) == 1, done.stderr
    assert done.stdout == ""
    left = [path for path in set(folder.rglob("*")) - before if path.name != "runs"]
    assert not left
    return lines[0]


def test_a_run_ends_with_a_table_a_folder_and_the_next_command(short):
    done = cosim("run", "short.yaml", "--out", "one", cwd=short)
    assert done.returncode == 0, done.stderr
    assert "GRI" in done.stdout
    assert "left to SUMO" in done.stdout
    assert "Next: cosim run short.yaml --baseline idm" in done.stdout
    assert "warm-up: 300/300" in done.stderr
    names = {path.name for path in (short / "one").iterdir()}
    assert {"steps.parquet", "groups.parquet", "events.parquet", "manifest.json", "episode.png"} <= names
    groups = pd.read_parquet(short / "one/groups.parquet")
    assert set(groups["driver"]) == {"gri"}
    assert len(groups) == len(pd.read_parquet(short / "one/counterparts.parquet")) >= 4
    facts = json.loads((short / "one/manifest.json").read_text())
    assert facts["arguments"]["seed"] == 1
    assert "--seed" in facts["arguments"]["sumo_arguments"]
    assert set(facts["inputs"]) == {"net", "checkpoint"}
    report = here("report", "one", "--episode", "1", cwd=short)
    assert report.returncode == 0, report.stderr
    assert (short / "one/episode-1.png").is_file()


@pytest.mark.slow  # batches of one and two workers are compared in any case
def test_runs_repeat_byte_for_byte_across_processes(short):
    if not (short / "one").exists():
        assert cosim("run", "short.yaml", "--out", "one", cwd=short).returncode == 0
    assert cosim("run", "short.yaml", "--out", "two", cwd=short).returncode == 0
    for table in ("steps", "groups", "events"):
        one, two = ((short / name / f"{table}.parquet").read_bytes() for name in ("one", "two"))
        assert one == two
    hashes = [json.loads((short / name / "manifest.json").read_text())["results"] for name in ("one", "two")]
    assert hashes[0] == hashes[1]


@pytest.mark.usefixtures("forked_workers")
def test_a_baseline_drives_the_same_groups(short):
    done = here("run", "short.yaml", "--baseline", "idm", "--out", "idm", cwd=short)
    assert done.returncode == 0, done.stderr
    groups, reference = (pd.read_parquet(short / name / "groups.parquet") for name in ("idm", "one"))
    ids = ["vehicle_0", "vehicle_1", "vehicle_2", "takeover_time"]
    pd.testing.assert_frame_equal(groups[ids].head(4), reference[ids].head(4))


@pytest.mark.usefixtures("forked_workers")
def test_fewer_groups_than_asked_for_are_told_in_the_table_and_by_the_exit_code(short):
    done = here("run", variant(short, "few.yaml", time_limit=20), "--episodes", "40", "--out", "few", cwd=short)
    assert done.returncode == 3, done.stderr
    found = int((pd.read_parquet(short / "few/groups.parquet")["driver"] == "gri").sum())
    assert 0 < found < 40
    assert f"{found} of 40" in done.stdout
    assert f"warning: {found} of 40 episodes: the time limit was reached" in done.stderr
    assert "chains of three vehicles in the study area seen, once a second: " in done.stderr
    assert "Next: " in done.stdout


def test_unknown_scenario(tmp_path):
    assert "did you mean 'us101_car_following'" in refused(tmp_path, "run", "us101_car_folowing", command=here)


def test_bad_override(short):
    line = refused(short, "run", "short.yaml", "--episodes", "0", command=here)
    assert "episodes: Expected `int` >= 1, got 0; change it" in line


@pytest.mark.parametrize(
    ("option", "value", "setting"),
    [
        ("--policy", "idm", "policy={kind: sumo}"),
        ("--baseline", "idm", "policy.kind=sumo"),
        ("--seed", "2", "seed=3"),
        ("--episodes", "2", "episodes=3"),
    ],
)
def test_what_an_option_of_its_own_says_cannot_be_set_as_well(short, option, value, setting):
    line = refused(short, "run", "short.yaml", option, value, "--set", setting, command=here)
    assert line.endswith(f"is also given by an option of its own ({value}); give one of them")


def test_net_that_crashes_sumo(short):
    """Well-formed, but an edge without junctions: SUMO dies of it natively."""
    (short / "crash.net.xml").write_text('<net><edge id="upstream"><lane id="upstream_0" index="0"/></edge></net>')
    line = refused(short, "run", variant(short, "crash.yaml", net="crash.net.xml"))
    assert "SUMO" in line


@pytest.mark.usefixtures("forked_workers")
def test_truncated_checkpoint(short):
    whole = find_checkpoint("us101_car_following").read_bytes()
    (short / "cut.pt").write_bytes(whole[: len(whole) // 2])
    name = variant(short, "cutck.yaml", policy={"kind": "gri", "checkpoint": "cut.pt"})
    assert "cut.pt: not a readable checkpoint" in refused(short, "run", name, command=here)


def test_existing_folder_is_not_overwritten(short):
    (short / "kept").mkdir(exist_ok=True)
    assert "exists already" in refused(short, "run", "short.yaml", "--out", "kept", command=here)


def test_report_of_something_else(tmp_path):
    assert "expected a run folder" in refused(tmp_path, "report", ".", command=here)


def test_ctrl_c_leaves_nothing_behind(short):
    command = [sys.executable, "-m", "cosim", "run", "us101_car_following", "--out", "stopped"]
    with subprocess.Popen(command, cwd=short, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        assert process.stderr is not None
        told = next((line for line in process.stderr if "warm-up" in line), None)
        assert told, "the run ended before its warm-up"
        time.sleep(0.5)
        os.killpg(process.pid, signal.SIGINT)
        errors = process.stderr.read()
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert not list(short.glob("stopped*"))


def test_list_names_what_is_shipped(tmp_path):
    assert "us101_car_following" in here("list", cwd=tmp_path).stdout
