"""The folder of a batch: damaged runs are set aside, damaged tables are never read."""

import os
from pathlib import Path

import pytest

from cosim.batch.store import BatchStore
from cosim.runs.run_reading import TABLES
from cosim.runs.share_reading import SHARE_TABLES
from gri.errors import InputError
from gri.storage.verification import DamagedError
from tests.cosim.runs.finished import finished_run, flip

RUNS = {"ra", "rb"}


@pytest.fixture
def store(tmp_path: Path) -> BatchStore:
    store = BatchStore(tmp_path / "batch")
    with store.opened(RUNS, pytest.fail):
        for k, run in enumerate(sorted(RUNS)):
            store.finish(run, finished_run(store.attempt_folder(run, 0), speed=20.0 + k))
    return store


def opened(store: BatchStore) -> list[str]:
    """What is said when the batch goes on."""
    said: list[str] = []
    with store.opened(RUNS, said.append):
        pass
    return said


def test_the_tables_hold_all_finished_runs_in_order(store):
    assert store.table("groups", ["rb", "ra", "rc"])["run"].astype(str).tolist() == ["rb", "ra"]
    assert store.table("steps", ["ra", "rb"])["v"].tolist() == [20.0, 20.0, 21.0, 21.0]
    assert opened(store) == []


@pytest.mark.parametrize("name", ["groups.parquet", "manifest.json", "scenario.json", "surroundings.parquet"])
def test_a_damaged_run_is_set_aside_and_done_again(store, name):
    flip(store.run_folder("ra") / name, 999)
    (said,) = opened(store)
    assert name in said
    assert said.endswith(f"this run is done again, its files are in {store.folder / 'damaged/ra'}")
    assert store.finished() == {"rb"}
    assert not (store.folder / "groups/run=ra").exists()
    assert store.table("groups", ["ra", "rb"])["run"].astype(str).tolist() == ["rb"]
    assert opened(store) == []


def test_a_run_that_is_damaged_twice_keeps_both(store):
    for _ in range(2):
        flip(store.run_folder("ra") / "steps.parquet", 999)
        assert len(opened(store)) == 1
        with store.opened(RUNS, pytest.fail):
            store.finish("ra", finished_run(store.attempt_folder("ra", 0)))
    assert sorted(os.listdir(store.folder / "damaged")) == ["ra", "ra.damaged"]


@pytest.mark.parametrize("table", ["groups", "counterparts"])
def test_a_damaged_table_is_refused_in_one_line(store, table):
    flip(store.folder / table / "run=ra/part.parquet", 999)
    with pytest.raises(
        InputError, match=rf"{table}/run=ra/part.parquet: is damaged .*; run `cosim batch` again"
    ) as said:
        store.table(table, ["ra", "rb"])
    assert "\n" not in str(said.value)


@pytest.mark.parametrize("damage", ["flipped", "missing"])
def test_a_damaged_copy_of_a_table_is_copied_again(store, damage):
    """Where the file system has no hard links, the run itself is as it was."""
    part = store.folder / "groups/run=ra/part.parquet"
    content = part.read_bytes()
    part.unlink()
    if damage == "flipped":
        part.write_bytes(content)
        flip(part, 999)
    with pytest.raises(InputError, match=r"part.parquet"):
        store.table("groups", ["ra"])
    assert opened(store) == []
    assert part.read_bytes() == content


def test_tables_are_links_to_the_files_of_the_runs(store):
    """They cost no space, also after a damaged one was replaced."""
    part, own = store.folder / "groups/run=ra/part.parquet", store.run_folder("ra") / "groups.parquet"
    assert part.samefile(own)
    content = own.read_bytes()
    part.unlink()
    part.write_bytes(content[:-1])
    assert opened(store) == []
    assert part.samefile(own)
    assert own.read_bytes() == content


def test_where_the_file_system_has_no_links_tables_are_copies(store, monkeypatch):
    def no_links(*_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(os, "link", no_links)
    with store.opened(RUNS | {"rc"}, pytest.fail):
        store.finish("rc", finished_run(store.attempt_folder("rc", 0), speed=25.0))
    assert store.table("steps", ["rc"])["v"].tolist() == [25.0, 25.0]
    assert not (store.folder / "steps/run=rc/part.parquet").samefile(store.run_folder("rc") / "steps.parquet")


def test_tables_of_shares_have_links_as_well_and_a_run_may_have_no_others(store):
    with store.opened(RUNS | {"rc"}, pytest.fail):
        partial = finished_run(store.attempt_folder("rc", 0))
        for table in TABLES[1:]:
            (partial / f"{table}.parquet").unlink()
        (partial / f"{TABLES[0]}.parquet").rename(partial / f"{SHARE_TABLES[0]}.parquet")
        store.finish("rc", partial)
    own = store.run_folder("rc") / f"{SHARE_TABLES[0]}.parquet"
    assert (store.folder / SHARE_TABLES[0] / "run=rc/part.parquet").samefile(own)
    assert not (store.folder / TABLES[0] / "run=rc").exists()
    assert store.has_table(SHARE_TABLES[0])


def test_a_batch_knows_which_tables_its_runs_wrote(store, tmp_path):
    assert store.has_table("groups")
    assert not store.has_table(SHARE_TABLES[0])
    empty = BatchStore(tmp_path / "empty")
    with empty.opened(set(), pytest.fail):
        assert {path.name for path in empty.folder.iterdir() if path.is_dir()} == {"runs", "failures", *TABLES}
    assert not empty.has_table("groups")


def test_results_that_cannot_be_published_leave_no_link(store):
    """Something is in their place; the error is told, and another attempt can be made."""
    with store.opened(RUNS | {"rc"}, pytest.fail):
        (store.run_folder("rc") / "inside").mkdir(parents=True)
        with pytest.raises(OSError, match="not empty"):
            store.finish("rc", finished_run(store.attempt_folder("rc", 0)))
        assert not list(store.folder.glob("*/run=rc"))


def test_a_sweep_removes_what_is_unfinished_and_nothing_else(store):
    (store.folder / ".scratch.1-abc.part").mkdir()
    store.attempt_folder("rc", 0).mkdir()
    store.attempt_folder("rd", 0).touch()  # no folder: it is left
    store.sweep()
    assert not (store.folder / ".scratch.1-abc.part").exists()
    assert not store.attempt_folder("rc", 0).exists()
    assert store.finished() == RUNS


def test_a_folder_without_a_manifest_or_runs_is_no_batch(store):
    for folder in (store.folder / "nowhere", store.folder):
        with pytest.raises(InputError, match="not the folder of a batch; `cosim batch FILE` writes one"):
            BatchStore(folder).manifest()
    store.write_manifest({"runs": []})
    assert store.manifest() == {"runs": []}
    store.write_manifest({"file": "a.yaml"})
    with pytest.raises(DamagedError, match=r"missing required field `runs`; run `cosim batch` again"):
        store.manifest()
    store.write_manifest({"runs": []})
    (store.folder / "runs").rename(store.folder / "elsewhere")
    with pytest.raises(InputError, match="not the folder of a batch"):
        store.manifest()


def test_a_record_of_a_failure_without_its_fields_counts_as_none(store):
    store.fail("rc", {"run": "rc"})
    store.fail("rd", {"run": "rd", "labels": {}, "attempts": [{"kind": "died", "message": "killed"}]})
    assert set(store.failures()) == {"rd"}


def test_a_damaged_record_of_a_failure_counts_as_none(store):
    with store.opened(RUNS, pytest.fail):
        store.fail("rc", {"run": "rc", "labels": {}, "attempts": []})
    assert set(store.failures()) == {"rc"}
    flip(store.folder / "failures/rc.json", 85)
    assert store.failures() == {}


def test_a_run_that_is_finished_after_all_has_failed_no_more(store):
    with store.opened(RUNS | {"rc"}, pytest.fail):
        store.fail("rc", {"run": "rc", "labels": {}, "attempts": []})
        store.finish("rc", finished_run(store.attempt_folder("rc", 1)))
    assert store.failures() == {}
    assert store.finished() == RUNS | {"rc"}


def test_a_damaged_manifest_is_refused(store):
    store.write_manifest({"runs": [], "batch": {}, "file": "a.yaml"})
    assert store.manifest()["file"] == "a.yaml"
    path = store.folder / "manifest.json"
    path.write_text(path.read_text().replace("a.yaml", "b.yaml"))
    with pytest.raises(InputError, match=r"manifest.json: is damaged .*; run `cosim batch` again"):
        store.manifest()


def test_a_second_command_is_refused_and_changes_nothing(store):
    with store.opened(RUNS, pytest.fail):
        (store.attempt_folder("rc", 0)).mkdir()
        with pytest.raises(InputError, match="writes there"), store.opened(RUNS, pytest.fail):
            pass
        assert store.attempt_folder("rc", 0).is_dir()
    assert opened(store) == []
    assert not store.attempt_folder("rc", 0).exists()
