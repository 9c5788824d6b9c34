"""A batch on disk: one folder per finished run, tables that join them, failures, a log and a manifest.

    runs/<id>/                     a run folder as `cosim run` writes it; it appears whole or not at all
    groups/run=<id>/part.parquet   its tables again (hard links), partitioned by run; counterparts/ etc. likewise
    traffic/run=<id>/part.parquet  the same for runs in which policies drive shares of the traffic
    failures/<id>.json             runs that failed finally, with their reasons
    log.jsonl                      one line per attempt: seconds, memory, outcome
    manifest.json                  file, versions, machine, and every run with its key, labels, state and hashes

Runs that a changed batch file no longer has stay in `runs/`, so that they need not be repeated when the file is changed
back. The tables hold only the runs of the current file.
"""

import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cosim.runs.run_reading import TABLES, read_json
from cosim.runs.share_reading import SHARE_TABLES
from gri.errors import InputError

PARTIAL = ".partial"


class BatchStore:
    """The folder of one batch."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @contextmanager
    def opened(self, runs: Iterable[str]) -> Iterator[None]:
        """Lock the folder for this process, remove unfinished attempts, and link the tables of these runs.

        Raises `InputError` if the folder cannot be written or another `cosim batch` uses it.
        """
        try:
            (self.folder / "runs").mkdir(parents=True, exist_ok=True)
            (self.folder / "failures").mkdir(exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot write to {self.folder}: {error.strerror}; give another --out") from None
        with _locked(self.folder / ".lock"):
            self.sweep()
            self._link_tables(set(runs))
            yield

    def sweep(self) -> None:
        """Remove the folders of unfinished attempts."""
        for path in (self.folder / "runs").glob(f"*{PARTIAL}"):
            shutil.rmtree(path, ignore_errors=True)

    def run_folder(self, run: str) -> Path:
        return self.folder / "runs" / run

    def attempt_folder(self, run: str, attempt: int) -> Path:
        """The folder in which an attempt writes; it does not exist yet, and no other process uses it."""
        return self.folder / "runs" / f"{run}-{os.getpid()}-{attempt}{PARTIAL}"

    def finished(self) -> set[str]:
        return {path.name for path in (self.folder / "runs").glob("*") if not path.name.endswith(PARTIAL)}

    def failures(self) -> dict[str, dict[str, Any]]:
        """The record of each run that failed finally, by run id."""
        records = sorted((self.folder / "failures").glob("*.json"))
        return {path.stem: read_json(path, dict[str, Any]) for path in records}

    def finish(self, run: str, partial: Path) -> None:
        """Publish the results of an attempt. The last step marks the run as finished; an OSError leaves it open."""
        try:
            self._link(run, partial)
            (self.folder / "failures" / f"{run}.json").unlink(missing_ok=True)
            os.replace(partial, self.run_folder(run))
        except OSError:
            for table in (*TABLES, *SHARE_TABLES):
                shutil.rmtree(self._part(table, run).parent, ignore_errors=True)
            raise

    def fail(self, run: str, record: Mapping[str, Any]) -> None:
        write_whole(self.folder / "failures" / f"{run}.json", json.dumps(record, indent=2) + "\n")

    def forget_failures(self) -> None:
        for path in (self.folder / "failures").glob("*.json"):
            path.unlink()

    def log(self, entry: Mapping[str, Any]) -> None:
        with (self.folder / "log.jsonl").open("a") as file:
            file.write(json.dumps(entry) + "\n")

    def write_manifest(self, content: Mapping[str, Any]) -> None:
        write_whole(self.folder / "manifest.json", json.dumps(content, indent=2) + "\n")

    def manifest(self) -> dict[str, Any]:
        """The manifest. Raises `InputError` if the folder is not that of a batch."""
        path = self.folder / "manifest.json"
        if not path.is_file() or not (self.folder / "runs").is_dir():
            raise InputError(f"{self.folder}: not the folder of a batch; `cosim batch FILE` writes one")
        return read_json(path, dict[str, Any])

    def _link_tables(self, runs: set[str]) -> None:
        """Let the tables hold those of these runs that have finished, and no others."""
        present = runs & self.finished()
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
            if not part.is_file():
                part.parent.mkdir(exist_ok=True, parents=True)
                _link_or_copy(source / f"{table}.parquet", part)


def _link_or_copy(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # the file system has no hard links
        temporary = target.with_suffix(".copy")
        shutil.copyfile(source, temporary)
        os.replace(temporary, target)


def write_whole(path: Path, text: str) -> None:
    """Write a file so that it appears whole or not at all."""
    temporary = path.with_name(path.name + ".part")
    try:
        temporary.write_text(text)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock that ends with this process, however it ends."""
    try:
        import fcntl
    except ImportError:  # Windows: two commands on one folder are not detected
        yield
        return
    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"{path.parent}: another `cosim batch` is running here; wait for it or stop it") from None
        yield
