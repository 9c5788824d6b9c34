"""A batch on disk: one folder per finished run, tables that join them, failures, a log and a manifest.

    runs/<id>/                     a run folder as `cosim run` writes it; it appears whole or not at all
    groups/run=<id>/part.parquet   its tables again (hard links), partitioned by run; counterparts/ etc. likewise
    traffic/run=<id>/part.parquet  the same for runs in which policies drive shares of the traffic
    shards/, groups/<shard>.parquet  many runs together, where the batch file asks for it (see cosim/batch/shards.py)
    failures/<id>.json             runs that failed finally, with their reasons
    log.jsonl                      one line per attempt: seconds, memory, outcome
    manifest.json                  file, versions, machine, and every run with its key, labels, state and hashes

Runs that a changed batch file no longer has stay in `runs/`, so that they need not be repeated when the file is changed
back. The linked tables hold only the runs of the current file; shards keep all of theirs.
"""

import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd
import pyarrow as pa

from cosim.batch.shards import (
    FIX,
    PackedRun,
    Shard,
    is_sharded,
    open_shards,
    pack,
    read_packed,
    read_shards,
    table_of_run,
)
from cosim.batch.spec import Shards
from cosim.runs.finished_run import read_manifest, verify_run
from cosim.runs.run_reading import TABLES
from cosim.runs.share_reading import SHARE_TABLES
from gri.errors import InputError, guarded_reading
from gri.storage.claims import claimed_folder
from gri.storage.verification import DamagedError, check_digest, digest, read_sealed, set_aside, write_sealed
from gri.storage.whole_files import publish, sweep, whole_file

PARTIAL = ".partial"


class _Listed(msgspec.Struct):
    run: str


class _Manifest(msgspec.Struct):
    """The fields of a manifest that no reader can do without."""

    runs: list[_Listed]


class _Attempt(msgspec.Struct):
    kind: str
    message: str


class _Failure(msgspec.Struct):
    """The record of a run that failed finally."""

    run: str
    labels: dict[str, Any]
    attempts: list[_Attempt]


class BatchStore:
    """The folder of one batch."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @contextmanager
    def opened(self, runs: Iterable[str], warn: Callable[[str], None], *, sharded: bool = False) -> Iterator[None]:
        """Claim the folder, remove unfinished attempts, set damaged runs aside, and link the tables of these runs.

        If finished runs are to go into shards (`sharded`), or once did, nothing is linked. `warn` is called with a
        sentence about each of these runs, and each shard, that is damaged. Raises `InputError` if the folder
        cannot be written or another command uses it.
        """
        with claimed_folder(self.folder):
            try:
                (self.folder / "runs").mkdir(exist_ok=True)
                (self.folder / "failures").mkdir(exist_ok=True)
            except OSError as error:
                raise InputError(f"cannot write to {self.folder}: {error.strerror}; give another --out") from None
            self.sweep()
            if sharded or is_sharded(self.folder):
                open_shards(self.folder, warn)
            self._set_damaged_aside(set(runs), warn)
            self._link_tables(set(runs))
            yield

    def _set_damaged_aside(self, runs: set[str], warn: Callable[[str], None]) -> None:
        for run in sorted(runs & self._in_folders()):
            try:
                verify_run(self.run_folder(run))
            except InputError as error:
                (self.folder / "damaged").mkdir(exist_ok=True)
                target = self.folder / "damaged" / run
                if target.exists():
                    set_aside(target)
                self.run_folder(run).rename(target)
                warn(f"{str(error).partition(';')[0]}; this run is done again, its files are in {target}")

    def sweep(self) -> None:
        """Remove the folders of unfinished attempts, and what killed processes left."""
        sweep(self.folder)
        for path in (self.folder / "runs").glob(f"*{PARTIAL}"):
            shutil.rmtree(path, ignore_errors=True)

    @property
    def scratch(self) -> Path:
        """Where the processes of the batch put hidden folders that are swept if they are left."""
        return self.folder.absolute()

    def run_folder(self, run: str) -> Path:
        return self.folder / "runs" / run

    def attempt_folder(self, run: str, attempt: int) -> Path:
        """The folder in which an attempt writes; it does not exist yet, and no other process uses it."""
        return self.folder / "runs" / f"{run}-{os.getpid()}-{attempt}{PARTIAL}"

    def finished(self) -> set[str]:
        return self._in_folders() | self.packed().keys()

    def packed(self) -> dict[str, PackedRun]:
        """The finished runs that are in shards, by id. Errors: `DamagedError`."""
        return {run.run: run for shard in read_shards(self.folder).values() for run in shard.runs}

    def pack(self, shards: Shards, runs: Mapping[str, int]) -> None:
        """Put those of these runs into one shard that have a folder. An OSError leaves them in their folders.

        `runs` are given with the number of starts that each was asked for.
        """
        there = self._in_folders()
        if found := {run: asked for run, asked in runs.items() if run in there}:
            pack(self.folder, shards, found)

    def _in_folders(self) -> set[str]:
        return {path.name for path in (self.folder / "runs").glob("*") if not path.name.endswith(PARTIAL)}

    def failures(self) -> dict[str, dict[str, Any]]:
        """The record of each run that failed finally, by run id; a damaged record counts as none."""
        found = {}
        for path in sorted((self.folder / "failures").glob("*.json")):
            try:
                found[path.stem] = read_sealed(path, FIX)
                msgspec.convert(found[path.stem], _Failure)
            except (InputError, msgspec.ValidationError):
                found.pop(path.stem, None)
        return found

    def finish(self, run: str, partial: Path) -> None:
        """Publish the results of an attempt. The last step marks the run as finished; an OSError leaves it open."""
        try:
            if not is_sharded(self.folder):
                self._link(run, partial)
            (self.folder / "failures" / f"{run}.json").unlink(missing_ok=True)
            publish(partial, self.run_folder(run))
        except OSError:
            for table in (*TABLES, *SHARE_TABLES):
                shutil.rmtree(self._part(table, run).parent, ignore_errors=True)
            raise

    def fail(self, run: str, record: Mapping[str, Any]) -> None:
        write_sealed(self.folder / "failures" / f"{run}.json", record)

    def forget_failures(self) -> None:
        for path in (self.folder / "failures").glob("*.json"):
            path.unlink()

    def log(self, entry: Mapping[str, Any]) -> None:
        with (self.folder / "log.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")

    def write_manifest(self, content: Mapping[str, Any]) -> None:
        write_sealed(self.folder / "manifest.json", content)

    def manifest(self) -> dict[str, Any]:
        """The manifest. Raises `InputError` if the folder is not that of a batch."""
        path = self.folder / "manifest.json"
        if not path.is_file() or not ((self.folder / "runs").is_dir() or is_sharded(self.folder)):
            raise InputError(f"{self.folder}: not the folder of a batch; `cosim batch FILE` writes one")
        content = read_sealed(path, FIX)
        try:
            msgspec.convert(content, _Manifest)
        except msgspec.ValidationError as error:
            raise DamagedError(f"{path}: {error}; {FIX}") from None
        return content

    def has_table(self, name: str) -> bool:
        """Whether a finished run wrote a table of this name."""
        if any((self.folder / name).glob("run=*")):
            return True
        return is_sharded(self.folder) and (
            any((self.folder / name).glob("*.parquet")) or any((self.folder / "runs").glob(f"*/{name}.parquet"))
        )

    def table(self, name: str, runs: Sequence[str]) -> pd.DataFrame:
        """The rows of a table, of those of these runs that have finished, as the runs wrote them.

        Raises `DamagedError` where they have been changed.
        """
        if not is_sharded(self.folder):
            return self._linked_table(name, runs)
        while True:
            folders = self._in_folders()  # before the shards: what is packed in between is in both, never in neither
            shards = read_shards(self.folder)
            try:
                return self._sharded_table(name, runs, shards, folders)
            except InputError:
                if read_shards(self.folder).keys() == shards.keys():
                    raise  # otherwise the batch packed runs meanwhile, so that their folders went away

    def _linked_table(self, name: str, runs: Sequence[str]) -> pd.DataFrame:
        finished, file = self._in_folders(), f"{name}.parquet"
        hashes = {run: read_manifest(self.run_folder(run))["results"] for run in runs if run in finished}
        wrote = {run: results[file] for run, results in hashes.items() if file in results}
        parts = [check_digest(self._part(name, run), wanted, FIX) for run, wanted in wrote.items()]
        with guarded_reading(self.folder / name, "table of a batch", FIX):
            return pd.read_parquet(parts)  # pyright: ignore[reportArgumentType]  # it reads lists as well

    def _sharded_table(
        self, name: str, runs: Sequence[str], shards: Mapping[str, Shard], folders: set[str]
    ) -> pd.DataFrame:
        not_packed = folders - {run.run for shard in shards.values() for run in shard.runs}
        loose = [run for run in runs if run in not_packed]
        parts = list(read_packed(self.folder, name, shards, runs))
        for run in loose:
            results, file = read_manifest(self.run_folder(run))["results"], f"{name}.parquet"
            if file in results:
                parts.append(table_of_run(check_digest(self.run_folder(run) / file, results[file], FIX), run))
        if not parts:
            raise InputError(
                f"{self.folder / name}: no run has finished that wrote this table; run `cosim batch` again"
            )
        parts = [part for part in parts if len(part)] or parts[:1]  # columns of empty tables have no types
        with guarded_reading(self.folder / name, "table of a batch", FIX):
            rows = pa.concat_tables(parts, promote_options="permissive").to_pandas()
        if "run" not in rows:
            raise DamagedError(f"{self.folder / name}: column run is missing; {FIX}")
        return rows.sort_values("run", key=lambda ids: ids.map({run: k for k, run in enumerate(runs)}), kind="stable")

    def _link_tables(self, runs: set[str]) -> None:
        """Let the tables hold those of these runs that have finished, and no others; none if there are shards."""
        linked = not is_sharded(self.folder)
        present = runs & self._in_folders() if linked else set()
        for table in TABLES:
            (self.folder / table).mkdir(exist_ok=True)
        for table in (*TABLES, *SHARE_TABLES):
            for path in (self.folder / table).glob("run=*"):
                if path.name.removeprefix("run=") not in present:
                    shutil.rmtree(path)
        for run in present:
            self._link(run, self.run_folder(run))

    def _part(self, table: str, run: str) -> Path:
        return self.folder / table / f"run={run}" / "part.parquet"

    def _link(self, run: str, source: Path) -> None:
        written = [table for table in (*TABLES, *SHARE_TABLES) if (source / f"{table}.parquet").is_file()]
        for table in written or TABLES:
            part = self._part(table, run)
            if not part.is_file() or digest(part) != digest(source / f"{table}.parquet"):
                part.unlink(missing_ok=True)
                part.parent.mkdir(exist_ok=True, parents=True)
                _link_or_copy(source / f"{table}.parquet", part)


def _link_or_copy(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # the file system has no hard links
        with whole_file(target) as part:
            shutil.copyfile(source, part)
