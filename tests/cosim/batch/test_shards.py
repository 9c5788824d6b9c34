"""Shards: few files, the same rows and bytes, and nothing lost when a command ends in between; no simulation."""

import os
from collections import deque
from pathlib import Path

import pandas as pd
import pytest
import typer
from pandas.testing import assert_frame_equal

from cosim.batch import shards
from cosim.batch.execute import Tally, execute
from cosim.batch.run_matrix import expand, load_batch
from cosim.batch.shards import read_shards
from cosim.batch.store import BatchStore
from cosim.commands.batch import batch
from cosim.process.task import Task, TaskResult
from gri.errors import InputError
from tests.cosim.runs.finished import finished_run, flip

FILE = "scenarios: [us101_car_following]\npolicies: {idm: {kind: idm}}\nseeds: {count: 5}\nretries: 0\n"
SHARDS = "shards: {runs: 2, tables: {events: all, steps: [time, v]}}\n"


class Sharded:
    """A batch of five runs, two of which go into one shard; the speeds of a run are its seed."""

    def __init__(self, folder: Path, text: str = FILE + SHARDS) -> None:
        (folder / "five.yaml").write_text(text)
        self.batch, self.file = load_batch(str(folder / "five.yaml"))
        self.runs = expand(self.batch, self.file)
        self.ids = [run.id for run in self.runs]
        self.store = BatchStore(folder / "out")
        self.said: list[str] = []
        self.done: list[str] = []

    def go(self, order: list[int] | None = None, fails: tuple[int, ...] = (), stop_after: int = 9) -> Tally:
        """Do what is left, in this order of the runs in the file; some fail, or the command is stopped."""
        self.done.clear()
        by_id = {run.id: run for run in self.runs}
        place = {self.ids[k]: n for n, k in enumerate(order or range(5))}

        def executor(queue: deque[Task], limit: float):
            for task in sorted(queue, key=lambda task: place[task.name]):
                if len(self.done) == stop_after:
                    raise KeyboardInterrupt
                self.done.append(task.name)
                labels = {"scenario": "us101_car_following", "seed": by_id[task.name].cell.seed}
                finished_run(task.folder, speed=float(labels["seed"]), labels=labels)
                failed = self.ids.index(task.name) in fails
                yield TaskResult(task.name, task.folder, "died" if failed else "done", "killed" if failed else "")

        return execute(
            self.batch,
            self.runs,
            self.store,
            executor,
            lambda tally: None,
            file=self.file,
            retry=True,
            warn=self.said.append,
        )

    def files(self) -> dict[str, bytes]:
        """All finished files with rows, and those of shards."""
        return {
            str(path.relative_to(self.store.folder)): path.read_bytes()
            for path in sorted(self.store.folder.rglob("*"))
            if path.is_file() and path.name not in ("manifest.json", "log.jsonl", ".lock")
        }


@pytest.fixture
def five(tmp_path: Path) -> Sharded:
    return Sharded(tmp_path)


def test_five_runs_are_three_shards_and_no_folder(five):
    assert five.go().done == 5
    found = read_shards(five.store.folder)
    assert sorted(len(shard.runs) for shard in found.values()) == [1, 2, 2]
    assert os.listdir(five.store.folder / "runs") == []
    assert {len(list((five.store.folder / name).iterdir())) for name in ("groups", "counterparts", "events")} == {3}
    assert not (five.store.folder / "graphs").exists() or not list((five.store.folder / "graphs").iterdir())
    entries = five.store.manifest()["runs"]
    assert [entry["state"] for entry in entries] == ["done"] * 5
    assert [(entry["starts"], entry["asked"]) for entry in entries] == [(1, 30)] * 5
    assert five.store.manifest()["states"] == {"done": 5}


def test_tables_have_the_rows_of_a_batch_with_folders(five, tmp_path):
    (tmp_path / "plain").mkdir()
    plain = Sharded(tmp_path / "plain", FILE)
    five.go()
    plain.go()
    for name in ("groups", "counterparts", "events"):
        wanted = plain.store.table(name, plain.ids).astype({"run": str}).reset_index(drop=True)
        assert_frame_equal(five.store.table(name, five.ids).reset_index(drop=True), wanted, check_dtype=False)
    steps = five.store.table("steps", five.ids)
    assert list(steps) == ["time", "v", "run"]
    assert steps["v"].tolist() == plain.store.table("steps", plain.ids)["v"].tolist()
    read = pd.read_parquet(five.store.folder / "groups")
    assert sorted(read["run"]) == sorted(five.ids)


def test_the_bytes_do_not_depend_on_when_runs_finish(five, tmp_path):
    five.go()
    (tmp_path / "other").mkdir()
    other = Sharded(tmp_path / "other")
    with pytest.raises(KeyboardInterrupt):
        other.go([4, 2, 0, 3, 1], stop_after=3)
    assert other.go([3, 1, 4, 2, 0]).done == 5
    assert len(other.done) == 2
    assert other.files() == five.files()


def test_results_are_readable_while_shards_are_incomplete(five):
    with pytest.raises(KeyboardInterrupt):
        five.go(stop_after=3)
    assert sorted(len(shard.runs) for shard in read_shards(five.store.folder).values()) == [2]
    assert len(os.listdir(five.store.folder / "runs")) == 1
    assert five.store.table("steps", five.ids)["run"].nunique() == 3
    assert five.store.table("groups", five.ids[::-1])["run"].tolist() == five.ids[2::-1]
    assert five.store.finished() == set(five.ids[:3])


def test_a_sharded_batch_knows_its_tables_and_says_which_it_has_not(five):
    """Three runs are done; two of them are in a shard, and one has a folder."""
    with pytest.raises(KeyboardInterrupt):
        five.go(stop_after=1)
    assert five.store.has_table("groups"), "in a folder"
    with pytest.raises(KeyboardInterrupt):
        five.go(stop_after=2)
    assert five.store.has_table("groups")
    assert not five.store.has_table("pair_graphs")
    with pytest.raises(InputError, match=r"pair_graphs: no run has finished that wrote this table"):
        five.store.table("pair_graphs", five.ids)
    assert five.go().done == 5
    assert five.store.has_table("groups"), "in shards"
    assert not five.store.has_table("pair_graphs")


def test_a_reader_sees_runs_that_are_packed_meanwhile(five, monkeypatch):
    with pytest.raises(KeyboardInterrupt):
        five.go(stop_after=3)
    seen = BatchStore._sharded_table

    def packed_first(self, *arguments):
        monkeypatch.setattr(BatchStore, "_sharded_table", seen)
        folder = five.store.run_folder(five.ids[2])
        content = (folder / "groups.parquet").read_bytes()
        five.go()
        folder.mkdir()  # as it looks while it is being removed
        (folder / "groups.parquet").write_bytes(content)
        return seen(self, *arguments)

    monkeypatch.setattr(BatchStore, "_sharded_table", packed_first)
    assert five.store.table("groups", five.ids)["run"].tolist() == five.ids


def test_a_reader_misses_no_run_that_is_packed_between_its_two_looks(five, monkeypatch):
    with pytest.raises(KeyboardInterrupt):
        five.go(stop_after=3)

    def packed_afterwards(folder):
        monkeypatch.setattr("cosim.batch.store.read_shards", read_shards)
        found = read_shards(folder)
        five.go()
        return found

    monkeypatch.setattr("cosim.batch.store.read_shards", packed_afterwards)
    assert set(five.ids[:3]) <= set(five.store.table("groups", five.ids)["run"])


def test_runs_with_an_empty_table_share_a_shard_with_others(five):
    """Runs of a policy without a graph have a table `graphs` without rows, whose columns have no types."""
    for k, run in enumerate(five.ids[:2]):
        graphs = pd.DataFrame({"time": pd.Series([1.0, 2.0][: 2 * k], dtype=float if k else object)})
        folder = five.store.run_folder(run)
        folder.mkdir(parents=True)
        graphs.to_parquet(folder / "graphs.parquet", index=False)
    parts = {run: five.store.run_folder(run) / "graphs.parquet" for run in five.ids[:2]}
    shards._write(five.store.folder / "graphs.parquet", parts, "all")
    assert pd.read_parquet(five.store.folder / "graphs.parquet")["time"].tolist() == [1.0, 2.0]
    shards._write(five.store.folder / "none.parquet", {five.ids[0]: parts[five.ids[0]]}, "all")
    assert pd.read_parquet(five.store.folder / "none.parquet").empty


def test_a_run_that_failed_is_in_a_shard_of_its_own_once_it_finishes(five):
    assert five.go(fails=(1,)).failed == 1
    assert sorted(len(shard.runs) for shard in read_shards(five.store.folder).values()) == [1, 1, 2]
    assert five.go().done == 5
    assert five.done == [five.ids[1]]
    assert sorted(len(shard.runs) for shard in read_shards(five.store.folder).values()) == [1, 1, 1, 2]


@pytest.mark.parametrize("what", ["groups", "steps", "shards"])
def test_a_damaged_shard_is_never_read_and_its_runs_are_done_again(five, what):
    five.go()
    before = five.files()
    name = next(name for name, shard in read_shards(five.store.folder).items() if len(shard.runs) == 2)
    flip(five.store.folder / what / f"{name}.{'json' if what == 'shards' else 'parquet'}", 3001)
    with pytest.raises(InputError, match=name):
        five.store.table("steps" if what == "shards" else what, five.ids)
    assert five.go().done == 5
    assert len(five.done) == 2
    assert len(five.said) == 1
    assert five.said[0].endswith(f"its runs are done again, its files are in {five.store.folder / 'damaged' / name}")
    assert {name: content for name, content in five.files().items() if "damaged" not in name} == before


def test_the_command_itself_gets_past_a_damaged_shard(five, monkeypatch):
    five.go()
    index = next((five.store.folder / "shards").glob("*.json"))
    index.write_bytes(index.read_bytes()[:200])
    checked = []
    monkeypatch.setattr("cosim.process.worker_process.run_in_worker", lambda _, runs, **__: checked.extend(runs))
    monkeypatch.setattr("cosim.batch.execute.execute", lambda *_, **__: Tally(5, 5, 0))
    with pytest.raises(typer.Exit):  # with code 3, as the runs have one start of thirty
        batch(str(five.file), out=five.store.folder)
    assert len(checked) == 5


def test_what_a_killed_command_left_is_cleared(five):
    """It was killed before a shard counted, or while folders of its runs were being removed."""
    five.go()
    before = five.files()
    (five.store.folder / "groups/s0123456789a.parquet").write_bytes(b"of a shard that was not finished")
    (five.store.folder / "groups/.s0123456789a.parquet.12-ab.part").write_bytes(b"of one that was being written")
    half = five.store.run_folder(five.ids[0])
    half.mkdir()
    (half / "steps.parquet").write_bytes(b"")
    assert five.go().done == 5
    assert five.done == []
    assert five.files() == before


def test_files_that_are_no_shards_are_left_alone(five):
    five.go()
    mine = [five.store.folder / name for name in ("groups/summary.parquet", "mine/s0123456789a.parquet")]
    mine[1].parent.mkdir()
    for path in mine:
        path.write_bytes(b"mine")
    five.go()
    assert all(path.read_bytes() == b"mine" for path in mine)


def test_a_full_disk_leaves_runs_in_their_folders_and_the_next_command_packs_them(five, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as broken:
        broken.setattr("cosim.batch.store.pack", full)
        assert five.go().done == 5
        assert "could not be packed" in five.said[0]
        assert five.store.finished() == set(five.ids)
    assert five.go().done == 5
    assert five.done == []
    assert len(read_shards(five.store.folder)) == 3


@pytest.mark.parametrize(
    ("kept", "said"),
    [
        ("{steps: [time, speed]}", r"shards: tables: steps: no column 'speed'; expected some of episode, driver"),
        ("{pair_graphs: all}", r"shards: tables: pair_graphs: the runs have no such table; leave it out"),
    ],
)
def test_tables_and_columns_that_no_run_has_are_refused_at_the_first(tmp_path, kept, said):
    wrong = Sharded(tmp_path, FILE + f"shards: {{tables: {kept}}}\n")
    with pytest.raises(InputError, match=said):
        wrong.go()
    assert len(wrong.done) == 1
    assert len(wrong.store.finished()) == 1


@pytest.mark.parametrize("wrong", ["{runs: 0}", "{tables: {steps: some}}", "{tables: {groups: all}}", "{size: 3}"])
def test_malformed_shards_are_refused_with_their_line(tmp_path, wrong):
    with pytest.raises(InputError, match=r"five\.yaml:5: field shards\.(runs|tables|size)"):
        Sharded(tmp_path, FILE + f"shards: {wrong}\n")


def test_folders_of_an_earlier_file_are_packed_and_shards_stay_when_the_file_has_none(tmp_path):
    plain = Sharded(tmp_path, FILE)
    plain.go()
    assert len(list((plain.store.folder / "groups").glob("run=*"))) == 5
    sharded = Sharded(tmp_path)
    assert sharded.go().done == 5
    assert sharded.done == []
    assert os.listdir(sharded.store.folder / "runs") == []
    assert not list(sharded.store.folder.glob("*/run=*"))
    assert plain.go().done == 5
    assert plain.done == []
    assert plain.store.table("groups", plain.ids)["run"].tolist() == plain.ids
