"""Batches as a person runs them: results, continuing, changing the file, and faults from outside."""

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from cosim.batch.execute import Tally
from cosim.commands.cli import app, main
from tests.command_line import in_this_process
from tests.cosim.commands.conftest import SHORT, cosim, tables


def states(folder: Path) -> Counter[str]:
    return Counter(run["state"] for run in json.loads((folder / "manifest.json").read_text())["runs"])


def log(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def test_a_dry_run_lists_the_runs_and_starts_none(short):
    done = in_this_process(main, "batch", "short.yaml", "--dry-run", "--out", "dry", cwd=short)
    assert "4 runs, none started." in done.stdout
    assert done.stdout.count("us101_car_following gri nominal plain seed") == 2
    assert not (short / "dry").exists()


def test_every_run_ends_in_the_tables_and_the_manifest(short):
    said = (short / "said").read_text()
    assert "4 of 4 finished, 0 failed" in said
    assert "runs: 4/4" in said
    manifest = json.loads((short / "two/manifest.json").read_text())
    assert manifest["states"] == {"done": 4}
    assert {"gri-cosim", "libsumo", "numpy", "torch", "python"} == set(manifest["versions"])
    assert len({run["key"] for run in manifest["runs"]}) == 4
    assert {entry["ended"] for entry in log(short / "two")} == {"done"}
    for run in manifest["runs"]:
        assert {"groups.parquet", "steps.parquet", "scenario.json", "manifest.json", "sumo.log"} <= {
            path.name for path in (short / "two/runs" / run["run"]).iterdir()
        }


def test_a_batch_in_shards_says_what_one_in_folders_says(short, tmp_path):
    (tmp_path / "short.yaml").write_text(SHORT + "shards: {runs: 3, tables: {steps: [time, role, v]}}\n")
    done = in_this_process(main, "batch", "short.yaml", "--out", "two", cwd=tmp_path)
    assert "4 of 4 finished, 0 failed" in done.stdout
    assert sorted(path.suffix for path in (tmp_path / "two/groups").iterdir()) == [".parquet"] * 2
    assert not list((tmp_path / "two/runs").iterdir())
    for arguments in (("results", "two"), ("results", "two", "--compare", "gri,idm"), ("results", "two", "--runs")):
        folders, shards = (in_this_process(main, *arguments, cwd=place) for place in (short, tmp_path))
        assert folders.stdout == shards.stdout
    assert len(pd.read_parquet(tmp_path / "two/steps", columns=["run", "v"])) > 0
    report = in_this_process(main, "report", "two", "--out", "report.html", cwd=tmp_path)
    assert report.returncode == 0
    assert "4 runs are in shards and cannot be shown here" in (tmp_path / "report.html").read_text()
    run = json.loads((tmp_path / "two/manifest.json").read_text())["runs"][0]["run"]
    in_this_process(main, "batch", "short.yaml", "--only", run, "--out", "again", cwd=tmp_path)
    assert tables(tmp_path / "again") == {
        name: content for name, content in tables(short / "two").items() if name.startswith(f"runs/{run}")
    }


def test_pandas_reads_the_tables_as_they_are(short):
    groups = pd.read_parquet(short / "two/groups")
    assert {"run", "scenario", "policy", "perturbation", "intensity", "variant", "seed", "driver"} <= set(groups)
    assert groups.groupby("policy")["run"].nunique().to_dict() == {"gri": 2, "idm": 2}
    assert set(groups["driver"]) == {"gri", "idm"}
    assert groups.loc[groups["policy"] == "gri", "edge_1_0"].notna().all()
    counterparts = pd.read_parquet(short / "two/counterparts")
    assert set(counterparts["policy"]) == {"left to SUMO"}
    assert len(counterparts) == len(groups)
    steps = pd.read_parquet(short / "two/steps", filters=[("run", "==", groups["run"].iloc[0])])
    assert steps["episode"].nunique() == (groups["run"] == groups["run"].iloc[0]).sum()


def test_duckdb_reads_the_tables_as_they_are(short):
    duckdb = pytest.importorskip("duckdb")
    path = short / "two/groups/*/*.parquet"
    rows = duckdb.sql(f"SELECT policy, count(DISTINCT run) FROM '{path}' GROUP BY policy ORDER BY policy").fetchall()
    assert rows == [("gri", 2), ("idm", 2)]


@pytest.mark.slow
def test_one_worker_writes_the_same_bytes_as_two(short):
    assert cosim("batch", "short.yaml", "--workers", 1, "--out", "one", cwd=short).returncode == 0
    assert tables(short / "one") == tables(short / "two")
    one, two = (json.loads((short / name / "manifest.json").read_text())["runs"] for name in ("one", "two"))
    assert one == two


@pytest.mark.slow
def test_a_second_call_repeats_nothing_and_a_changed_file_only_what_changed(short):
    (short / "changing.yaml").write_text(SHORT)
    arguments = ("batch", "changing.yaml", "--workers", "2", "--out", "changing")
    assert cosim(*arguments, cwd=short).returncode == 0
    before = log(short / "changing")
    assert "4 of 4 finished" in cosim(*arguments, cwd=short).stdout
    assert log(short / "changing") == before
    (short / "changing.yaml").write_text(SHORT.replace("idm: {kind: idm}", "still: {kind: constant_velocity}"))
    assert "4 of 4 finished" in cosim(*arguments, cwd=short).stdout
    assert len(log(short / "changing")) == len(before) + 2
    groups = pd.read_parquet(short / "changing/groups")
    assert set(groups["policy"]) == {"gri", "still"}, "the tables hold the runs of the present file"
    (short / "changing.yaml").write_text(SHORT)
    assert "4 of 4 finished" in cosim(*arguments, cwd=short).stdout
    assert len(log(short / "changing")) == len(before) + 2, "changing back costs nothing"


@pytest.mark.slow
def test_failures_are_listed_with_their_reason_and_tried_again_on_demand(short):
    text = SHORT + "variants:\n  fine: {}\n  lost: {group: {max_gap: 2.001}}\n"
    (short / "failing.yaml").write_text(text)
    done = cosim("batch", "failing.yaml", "--workers", "2", "--out", "failing", cwd=short)
    assert done.returncode == 1
    assert "4 of 8 finished, 4 failed" in done.stdout
    assert "Next: cosim results failing --failures" in done.stdout
    failure = json.loads(next((short / "failing/failures").iterdir()).read_text())
    assert "no group fits the rule" in failure["attempts"][0]["message"]
    assert len(failure["attempts"]) == 1, "a bad input is not tried twice"
    entries = len(log(short / "failing"))
    assert cosim("batch", "failing.yaml", "--out", "failing", cwd=short).returncode == 1
    assert len(log(short / "failing")) == entries
    assert cosim("batch", "failing.yaml", "--out", "failing", "--retry-failed", cwd=short).returncode == 1
    assert len(log(short / "failing")) == entries + 4


def limited(bytes_: int) -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_, bytes_))


@pytest.mark.slow
def test_no_room_for_results_fails_the_runs_and_leaves_nothing_half_written(short):
    """A limit on the size of files stands in for a full disk: writing fails in the middle of a table."""
    command = [sys.executable, "-m", "cosim", "batch", "short.yaml", "--workers", "2", "--out", "full"]
    done = subprocess.run(
        command, cwd=short, capture_output=True, text=True, timeout=300, preexec_fn=lambda: limited(8000)
    )
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "0 of 4 finished, 4 failed" in done.stdout
    for path in (short / "full/failures").iterdir():
        attempts = json.loads(path.read_text())["attempts"]
        assert [attempt["kind"] for attempt in attempts] == ["error", "error"], "tried twice"
        assert "too large" in attempts[0]["message"]
    assert not list((short / "full/runs").iterdir())
    assert not list((short / "full").glob("*/run=*"))
    assert "4 of 4 finished" in cosim("batch", "short.yaml", "--retry-failed", "--out", "full", cwd=short).stdout
    assert tables(short / "full") == tables(short / "two")


def started(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "cosim", "batch", *arguments]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.slow
def test_ctrl_c_costs_what_is_under_way_and_no_more(short):
    (short / "many.yaml").write_text(SHORT.replace("[1, 2]", "{count: 15}"))
    with started(short, "many.yaml", "--workers", "2", "--out", "many") as process:
        while len(list((short / "many").glob("runs/r???????????"))) < 3:
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        errors = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert "cosim batch many.yaml" in errors, "how to go on"
    finished = states(short / "many")["done"]
    assert 3 <= finished < 30
    assert not list((short / "many").glob("runs/*.partial"))
    again = cosim("batch", "many.yaml", "--workers", "2", "--out", "many", cwd=short)
    assert "30 of 30 finished" in again.stdout
    assert Counter(entry["run"] for entry in log(short / "many")).most_common(1)[0][1] == 1, "none was done twice"


TRUNKS = (
    SHORT.replace("[1, 2]", "[1]").replace("episodes: 2", "episodes: 5\n  groups_at_once: 2")
    + "perturbations:\n  close: {kind: headway_ratio, intensities: [0.9]}\n"
).replace("  idm: {kind: idm}\n", "  idm: {kind: idm}\n  still: {kind: constant_velocity}\n")


def below(process: int) -> dict[int, int]:
    """The processes that a process has started, and those started by these, and so on; by id, how far below it."""
    children: dict[int, list[int]] = {}
    for place in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, parent = place.read_text().rpartition(")")[2].split()[:2]
            if state != "Z":
                children.setdefault(int(parent), []).append(int(place.parent.name))
    found, level, depth = {}, children.get(process, []), 1
    while level:
        found |= dict.fromkeys(level, depth)
        level, depth = [child for one in level for child in children.get(one, [])], depth + 1
    return found


def wait_for(condition, seconds: float = 120.0) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, "waited in vain"
        time.sleep(0.05)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="looks for processes where Linux lists them")
def test_a_batch_that_is_killed_while_trunks_wait_goes_on_with_the_same_bytes(tmp_path):
    """At first the whole command is killed, then the trunks of the one that goes on, which costs no run."""
    (tmp_path / "trunks.yaml").write_text(TRUNKS)
    assert cosim("batch", "trunks.yaml", "--workers", "1", "--out", "whole", cwd=tmp_path).returncode == 0
    folder = tmp_path / "killed"

    def finished() -> int:
        return len(list(folder.glob("runs/r???????????")))

    def trunks(process: subprocess.Popen[str], runs: int) -> list[int]:
        """The processes that wait from one run to the next, when so many runs are finished."""
        wait_for(lambda: finished() >= runs - 1)
        before = below(process.pid)
        wait_for(lambda: finished() >= runs)
        found = [one for one in below(process.pid) if before.get(one, 0) > 2]  # below the process of the warm-up
        assert len(found) > 1, "one at the end of the warm-up, and one at each take-over"
        return found

    command = "trunks.yaml", "--workers", "1", "--out", "killed"
    with started(tmp_path, *command) as process:
        trunks(process, 2)
        left = below(process.pid)
        process.kill()
        process.communicate()
    wait_for(lambda: not any(Path(f"/proc/{one}").exists() for one in left))
    assert 2 <= finished() < 5
    with started(tmp_path, *command) as process:
        for one in trunks(process, finished() + 2):
            with suppress(ProcessLookupError):
                os.kill(one, signal.SIGKILL)
        said, errors = process.communicate(timeout=120)
    assert "6 of 6 finished, 0 failed" in said, errors
    assert tables(folder) == tables(tmp_path / "whole")
    assert not list(folder.glob("runs/*.partial"))
    assert Counter(entry["run"] for entry in log(folder) if entry["ended"] == "done").most_common(1)[0][1] == 1


@pytest.mark.usefixtures("forked_workers")
def test_a_policy_that_does_not_fit_is_refused_before_anything_runs(short):
    (short / "unfit.yaml").write_text(SHORT.replace("horizon: 2.0", "horizon: 2.0\n  history: 2.0"))
    done = in_this_process(main, "batch", "unfit.yaml", "--out", "unfit", cwd=short)
    assert done.returncode == 2, done.stderr
    assert "us101_car_following gri nominal plain seed" in done.stderr
    assert "the policy wants 25 states" in done.stderr
    assert not (short / "unfit").exists()


@pytest.mark.slow
def test_two_commands_do_not_share_a_folder(short):
    (short / "shared.yaml").write_text(SHORT.replace("[1, 2]", "{count: 15}"))
    with started(short, "shared.yaml", "--workers", "1", "--out", "shared") as process:
        while not (short / "shared/.lock").exists():
            time.sleep(0.05)
        second = cosim("batch", "shared.yaml", "--out", "shared", cwd=short)
        process.kill()
        process.communicate()
    assert second.returncode == 2
    assert f"(process {process.pid} on " in second.stderr
    assert "writes there; wait for it, stop it, or give another --out" in second.stderr


@pytest.mark.slow
def test_ray_writes_the_same_bytes(short):
    pytest.importorskip("ray")
    done = cosim("batch", "short.yaml", "--executor", "ray", "--workers", "2", "--out", "ray", cwd=short)
    assert done.returncode == 0, done.stderr
    assert tables(short / "ray") == tables(short / "two")


def test_fewer_groups_than_asked_for_is_exit_code_3(tmp_path, monkeypatch):
    """All runs are done; one of the two found 1 of its 2 starts within the time limit."""
    (tmp_path / "short.yaml").write_text(SHORT)
    monkeypatch.chdir(tmp_path)
    found = {"starts": [2, 2, 2, 2]}

    def finished(spec, runs, store, *_, **__):
        listed = [
            {"run": run.id, "starts": starts, "asked": 2} for run, starts in zip(runs, found["starts"], strict=True)
        ]
        store.folder.mkdir(exist_ok=True)
        (store.folder / "runs").mkdir(exist_ok=True)
        store.write_manifest({"batch": {}, "runs": listed})
        return Tally(len(runs), len(runs), 0)

    monkeypatch.setattr("cosim.batch.execute.execute", finished)
    monkeypatch.setattr("cosim.process.worker_process.run_in_worker", lambda *_, **__: None)
    for starts, code in (([2, 2, 2, 2], 0), ([2, 1, 2, 2], 3)):
        found["starts"] = starts
        done = CliRunner().invoke(app, ["batch", "short.yaml", "--out", "out"])
        assert done.exit_code == code
    assert "1 runs found fewer groups than asked for" in done.stderr
