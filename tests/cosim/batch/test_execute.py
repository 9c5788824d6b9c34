"""Attempts at the runs of a batch: how many, for which failures, and what is recorded; no simulation."""

import json
from collections import Counter, deque
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from cosim.batch import execute as execution
from cosim.batch.execute import Tally, _shared_warm_ups, execute, in_order_of_warm_ups
from cosim.batch.run_matrix import expand, load_batch
from cosim.batch.store import BatchStore
from cosim.process.task import Task, TaskResult
from cosim.spec.scenario import tag_of
from cosim.spec.warm_up import warm_up_key
from tests.cosim.runs.finished import finished_run, flip

TWO_RUNS = "scenarios: [us101_car_following]\npolicies: {idm: {kind: idm}}\nseeds: [1, 2]\nretries: 2\n"


class Batch:
    """A batch of two runs in a folder, whose attempts end as `ends` says: the kinds of one run after the other."""

    def __init__(self, folder: Path) -> None:
        (folder / "two.yaml").write_text(TWO_RUNS)
        self.batch, self.file = load_batch(str(folder / "two.yaml"))
        self.runs = expand(self.batch, self.file)
        self.store = BatchStore(folder / "out")
        self.attempts: Counter[str] = Counter()
        self.said: list[str] = []
        self.folders: list[Path] = []
        self.tallies: list[tuple[int, int, int]] = []
        self.states: list[dict[str, int]] = []  # as the manifest has them while an attempt runs

    def go(self, ends: dict[str, list[str]], *, retry: bool = False) -> Tally:
        self.attempts.clear()

        def executor(queue: deque[Task], limit: float):
            while queue:
                task = queue.popleft()
                assert not any(folder.exists() for folder in self.folders), "of an attempt that has ended"
                self.folders.append(task.folder)
                self.states.append(self.store.manifest()["states"])
                kind = ends[task.name][self.attempts[task.name]]
                self.attempts[task.name] += 1
                if kind == "done":
                    finished_run(task.folder)
                elif kind != "gone":
                    task.folder.mkdir()
                if kind == "stopped":
                    raise KeyboardInterrupt
                kind = "died" if kind == "gone" else kind
                yield TaskResult(task.name, task.folder, kind, "" if kind == "done" else f"it {kind}")  # type: ignore[arg-type]

        def tell(tally: Tally) -> None:
            self.tallies.append((tally.done, tally.failed, tally.left))

        return execute(
            self.batch, self.runs, self.store, executor, tell, file=self.file, retry=retry, warn=self.said.append
        )


@pytest.fixture
def two(tmp_path: Path) -> Batch:
    return Batch(tmp_path)


def test_a_run_is_tried_again_as_often_as_the_file_says(two):
    a, b = (run.id for run in two.runs)
    tally = two.go({a: ["died", "timeout", "error", "done"], b: ["died", "error", "done"]})
    assert two.attempts == {a: 3, b: 3}  # the first attempt and two more
    assert (tally.done, tally.failed) == (1, 1)
    assert [attempt["kind"] for attempt in two.store.failures()[a]["attempts"]] == ["died", "timeout", "error"]
    states = {entry["run"]: entry["state"] for entry in two.store.manifest()["runs"]}
    assert states == {a: "failed", b: "done"}
    log = [json.loads(line) for line in (two.store.folder / "log.jsonl").read_text().splitlines()]
    assert [entry["attempt"] for entry in log if entry["run"] == a] == [1, 2, 3]


def test_the_tally_is_told_at_the_beginning_and_after_every_attempt(two):
    a, b = (run.id for run in two.runs)
    two.go({a: ["died", "done"], b: ["input"]})
    assert two.tallies == [(0, 0, 2), (0, 0, 2), (0, 1, 1), (1, 1, 0)]
    assert Tally(10, 4, 3).ended == 7
    two.go({})
    assert two.tallies[4:] == [(1, 1, 0)]


def test_the_manifest_can_be_read_from_the_beginning_and_at_the_end_has_every_state(two):
    a, b = (run.id for run in two.runs)
    two.go({a: ["input"], b: ["done"]})
    assert two.states[0] == {"open": 2}
    entries = {entry["run"]: entry for entry in two.store.manifest()["runs"]}
    assert two.store.manifest()["states"] == {"failed": 1, "done": 1}
    assert "groups.parquet" in entries[b]["results"]
    assert (entries[b]["starts"], entries[b]["asked"]) == (1, 30)
    assert {"results", "starts", "asked"}.isdisjoint(entries[a])
    with pytest.raises(KeyboardInterrupt):
        two.go({a: ["stopped"]}, retry=True)
    assert two.store.manifest()["states"] == {"open": 1, "done": 1}


def test_an_attempt_that_ends_before_it_made_its_folder_is_one(two):
    a, b = (run.id for run in two.runs)
    assert two.go({a: ["gone", "done"], b: ["done"]}).done == 2


def test_results_that_cannot_be_stored_are_a_failed_attempt(two, monkeypatch):
    a, b = (run.id for run in two.runs)
    publish = two.store.finish

    def full_at_first(run: str, partial: Path) -> None:
        if two.attempts[a] == 1 and run == a:
            raise OSError(28, "No space left on device", str(partial))
        publish(run, partial)

    monkeypatch.setattr(two.store, "finish", full_at_first)
    assert two.go({a: ["done", "done"], b: ["done"]}).done == 2
    assert two.attempts == {a: 2, b: 1}
    log = [json.loads(line) for line in (two.store.folder / "log.jsonl").read_text().splitlines()]
    assert [entry["ended"] for entry in log if entry["run"] == a] == ["error", "done"]


def test_runs_without_a_common_warm_up_keep_their_places(two):
    """Of six runs the second, fourth and sixth share traffic; the others have their own."""
    scenarios = [msgspec.structs.replace(two.runs[0].scenario, seed=k) for k in range(6)]
    runs = [replace(two.runs[0], key=str(k), scenario=scenario) for k, scenario in enumerate(scenarios)]
    keys = {run.id: "common" if k % 2 else "" for k, run in enumerate(runs)}
    assert [run.id for run in in_order_of_warm_ups(runs, keys)] == ["r0", "r1", "r3", "r5", "r2", "r4"]
    assert set(_shared_warm_ups(runs, keys, Path("scratch"))) == {"r1", "r3", "r5"}
    assert _shared_warm_ups(runs[:3], keys, Path("scratch")) == {}, "there is only one of them"


def test_the_key_of_a_warm_up_is_computed_once_per_run(two, monkeypatch):
    asked = []
    monkeypatch.setattr(execution, "warm_up_key", lambda scenario: asked.append(scenario) or "")
    a, b = (run.id for run in two.runs)
    two.go({a: ["done"], b: ["done"]})
    assert asked == [run.scenario for run in two.runs]


def test_bad_input_is_tried_once(two):
    a, b = (run.id for run in two.runs)
    two.go({a: ["input"], b: ["done"]})
    assert two.attempts == {a: 1, b: 1}


def test_what_has_ended_is_not_done_again_unless_it_is_asked_for(two):
    a, b = (run.id for run in two.runs)
    two.go({a: ["input"], b: ["done"]})
    two.go({})
    assert not two.attempts
    assert two.go({a: ["done"]}, retry=True).done == 2
    assert two.attempts == {a: 1}
    assert not two.store.failures()


def test_a_damaged_run_is_done_again_and_said(two):
    a, b = (run.id for run in two.runs)
    two.go({a: ["done"], b: ["done"]})
    before = (two.store.run_folder(a) / "groups.parquet").read_bytes()
    flip(two.store.run_folder(a) / "groups.parquet", 5000)
    assert two.go({a: ["done"]}).done == 2
    assert two.attempts == {a: 1}
    assert len(two.said) == 1
    assert "is done again" in two.said[0]
    assert (two.store.run_folder(a) / "groups.parquet").read_bytes() == before


def test_every_attempt_has_a_folder_of_its_own_and_none_is_left(two):
    a, b = (run.id for run in two.runs)
    two.go({a: ["died", "died", "done"], b: ["input"]})
    assert len(set(two.folders)) == 4
    with pytest.raises(KeyboardInterrupt):
        two.go({b: ["stopped"]}, retry=True)
    assert [path.name for path in (two.store.folder / "runs").iterdir()] == [a]


def test_what_a_killed_warm_up_left_is_removed(two):
    left = two.store.scratch / ".scratch-abc.part"
    left.mkdir(parents=True)
    (left / "routes.rou.xml").write_text("<routes>")
    a, b = (run.id for run in two.runs)
    two.go({a: ["done"], b: ["done"]})
    assert not left.exists()
    assert two.store.finished() == {a, b}


def test_two_runs_in_the_same_traffic_share_its_warm_up_and_one_alone_has_none(tmp_path: Path):
    (tmp_path / "shared.yaml").write_text(
        TWO_RUNS.replace("{idm: {kind: idm}}", "{idm: {kind: idm}, left: {kind: sumo}}")
    )
    runs = expand(*load_batch(str(tmp_path / "shared.yaml")))
    keys = {run.id: warm_up_key(run.scenario) for run in runs}
    ordered = in_order_of_warm_ups(runs[:3], keys)
    found = _shared_warm_ups(ordered, keys, Path("scratch"))
    alone, both = sorted(([run for run in ordered if run.scenario.seed == seed] for seed in (1, 2)), key=len)
    assert [len(alone), len(both)] == [1, 2]
    assert alone[0].id not in found
    first, second = (found[run.id] for run in both)
    assert first.key == second.key
    assert {tag_of(scenario.policy) for scenario in first.arguments[2:]} == {"idm", "sumo"}
    assert ordered.index(both[1]) == ordered.index(both[0]) + 1
