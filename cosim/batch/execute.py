"""Running what is left of a batch: which runs, how many attempts, and the records of them."""

import os
import platform
import shutil
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec

from cosim.batch.run_matrix import PACKAGES, Run
from cosim.batch.shards import check_kept, starts_of
from cosim.batch.spec import Batch, Shards
from cosim.batch.store import BatchStore
from cosim.process.task import Preparation, Task, TaskResult, TaskResults
from cosim.runs.finished_run import read_manifest
from cosim.spec.warm_up import warm_up_key

Executor = Callable[[deque[Task], float], TaskResults]  # (queue, time limit [s])
NOT_RETRIED = ("input",)  # kinds of failure that a second attempt cannot fix


@dataclass(frozen=True)
class Tally:
    """The state of a batch: numbers of all runs, of finished runs, and of runs that failed finally."""

    total: int
    done: int
    failed: int

    @property
    def ended(self) -> int:
        return self.done + self.failed

    @property
    def left(self) -> int:
        return self.total - self.ended


Tell = Callable[[Tally], None]
Warn = Callable[[str], None]


def execute(
    batch: Batch,
    runs: Sequence[Run],
    store: BatchStore,
    executor: Executor,
    tell: Tell,
    *,
    file: Path,
    retry: bool,
    warn: Warn,
) -> Tally:
    """Do every run that has neither finished nor failed yet; with `retry`, also those that failed.

    `tell` is called with the tally after every attempt. `warn` is called with a sentence about each finished run that
    is damaged and done again, and each record that cannot be written. However this ends, the manifest has the state of
    every run, and every finished run is complete.
    """
    by_id = {run.id: run for run in runs}
    with store.opened(by_id, warn, sharded=batch.shards is not None):
        if retry:
            store.forget_failures()
        done, failed = store.finished() & set(by_id), set(store.failures()) & set(by_id)
        tally = Tally(len(runs), len(done), len(failed - done))
        attempts: Counter[str] = Counter()
        reasons: dict[str, list[dict[str, Any]]] = {}
        keys = {run.id: warm_up_key(run.scenario) for run in runs}
        ordered = in_order_of_warm_ups(runs, keys)
        left = [run for run in ordered if run.id not in done | failed]
        warm_ups = _shared_warm_ups(left, keys, store.scratch)
        queue = deque(_task(run, store, 0, warm_ups) for run in left)
        packing = _Packing(batch.shards, ordered, store, warn)
        packing.begin(done | failed)
        tell(tally)
        record = partial(_write_record, lambda: store.write_manifest(manifest(batch, runs, store, file)), warn)
        record()  # so that results can be read from now on
        try:
            with closing(executor(queue, batch.time_limit)) as answers:  # leaving it ends all running tasks
                for answer in answers:
                    run = by_id[answer.name]
                    answer = _published(answer, store)
                    attempts[run.id] += 1
                    if answer.kind == "done":
                        tally = replace(tally, done=tally.done + 1)
                        packing.ended(run.id)
                    else:
                        reasons.setdefault(run.id, []).append({"kind": answer.kind, "message": answer.message})
                        if answer.kind not in NOT_RETRIED and attempts[run.id] <= batch.retries:
                            queue.append(_task(run, store, attempts[run.id], warm_ups))
                        else:
                            _write_record(partial(store.fail, run.id, _failure(run, reasons[run.id])), warn)
                            tally = replace(tally, failed=tally.failed + 1)
                            packing.ended(run.id)
                    _write_record(partial(store.log, _log_entry(answer, attempts[run.id])), warn)
                    tell(tally)
        finally:
            store.sweep()
            record()
        return tally


class _Packing:
    """Packs finished runs into shards: the first so many of the batch into one, the next into another.

    A shard is packed when all its runs have ended, so that its bytes do not depend on when each of them finished.
    """

    def __init__(self, shards: Shards | None, runs: Sequence[Run], store: BatchStore, warn: Warn) -> None:
        self._shards, self._store, self._warn = shards, store, warn
        self._members = [runs[k : k + shards.runs] for k in range(0, len(runs), shards.runs)] if shards else []
        self._place = {run.id: k for k, members in enumerate(self._members) for run in members}
        self._open = [{run.id for run in members} for members in self._members]
        self._checked = False

    def begin(self, ended: Iterable[str]) -> None:
        """Pack what ended before this command."""
        for run in set(ended) & set(self._place):
            self._open[self._place[run]].discard(run)
        for place in range(len(self._members)):
            self._pack_if_complete(place)

    def ended(self, run: str) -> None:
        """Pack the shard of a run that has finished, or failed for good, if it was the last one."""
        if self._shards is None:
            return
        if not self._checked and (folder := self._store.run_folder(run)).is_dir():
            check_kept(self._shards, folder)
            self._checked = True
        self._open[self._place[run]].discard(run)
        self._pack_if_complete(self._place[run])

    def _pack_if_complete(self, place: int) -> None:
        if self._shards is None or self._open[place]:
            return
        members = {run.id: run.scenario.episodes for run in self._members[place]}
        try:
            self._store.pack(self._shards, members)
        except OSError as error:
            self._warn(f"{len(members)} runs could not be packed into a shard, and keep their folders: {error}")


def in_order_of_warm_ups(runs: Sequence[Run], keys: Mapping[str, str]) -> list[Run]:
    """The runs in the order in which they are done: those that share a warm-up follow each other.

    `keys` are their `warm_up_key`s by their ids.
    """
    first: dict[str, int] = {}
    places = [first.setdefault(key, k) if (key := keys[run.id]) else k for k, run in enumerate(runs)]
    return [runs[k] for k in sorted(range(len(runs)), key=lambda k: (places[k], k))]


def _shared_warm_ups(runs: Sequence[Run], keys: Mapping[str, str], scratch: Path) -> Mapping[str, Preparation]:
    """The warm-ups that several of these runs share, by the ids of the runs, with their files in `scratch`."""
    sharing: dict[str, list[Run]] = {}
    for run in runs:
        if keys[run.id]:
            sharing.setdefault(keys[run.id], []).append(run)
    found = {}
    for key, members in sharing.items():
        if len(members) > 1:
            policies = {msgspec.json.encode(run.scenario.policy): run.scenario for run in members}.values()
            arguments = (members[0].scenario, str(scratch), *policies)
            shared = Preparation(key, "cosim.runs.shared_warm_up:shared_warm_up", arguments)
            found |= {run.id: shared for run in members}
    return found


def _task(run: Run, store: BatchStore, attempt: int, warm_ups: Mapping[str, Preparation]) -> Task:
    arguments, preparation = (run.scenario, msgspec.to_builtins(run.cell), run.key), warm_ups.get(run.id)
    folder = store.attempt_folder(run.id, attempt)
    return Task(run.id, "cosim.batch.run_task:run_task", arguments, folder, preparation)


def _published(answer: TaskResult, store: BatchStore) -> TaskResult:
    """Publish the results of a successful attempt, or remove those of a failed one.

    If publishing fails, the returned answer is that of a failed attempt.
    """
    if answer.kind == "done":
        try:
            store.finish(answer.name, answer.folder)
        except OSError as error:
            answer = replace(
                answer, kind="error", message=f"its results cannot be stored: {error.strerror} ({error.filename})"
            )
    shutil.rmtree(answer.folder, ignore_errors=True)  # published results are no longer there
    return answer


def _write_record(write: Callable[[], None], warn: Warn) -> None:
    """Write a record. On a full disk the batch goes on; the run stays open, and the next command repeats it."""
    try:
        write()
    except OSError as error:
        warn(f"a record could not be written: {error}")


def _failure(run: Run, reasons: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return {"run": run.id, "labels": msgspec.to_builtins(run.cell), "attempts": list(reasons)}


def _log_entry(answer: TaskResult, attempt: int) -> dict[str, Any]:
    seconds, peak = round(answer.seconds, 3), round(answer.peak_mb, 1)
    return {"run": answer.name, "attempt": attempt, "ended": answer.kind, "seconds": seconds, "peak_mb": peak}


def manifest(batch: Batch, runs: Sequence[Run], store: BatchStore, file: Path) -> dict[str, Any]:
    """The manifest: batch file, versions, machine, and the state of each run with the hashes of its results."""
    finished, packed, failures = store.finished(), store.packed(), store.failures()
    listed = []
    for run in runs:
        state = "done" if run.id in finished else "failed" if run.id in failures else "open"
        entry: dict[str, Any] = {"run": run.id, "key": run.key, **msgspec.to_builtins(run.cell), "state": state}
        if run.id in packed:
            entry |= {"starts": packed[run.id].starts, "asked": packed[run.id].asked}
        elif state == "done":
            own = read_manifest(store.run_folder(run.id))
            asked = run.scenario.episodes
            entry |= {"results": own.get("results", {}), "starts": starts_of(own, asked), "asked": asked}
        listed.append(entry)
    return {
        "file": str(file),
        "batch": msgspec.to_builtins(batch),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
        "machine": {"system": platform.system(), "processor": platform.machine(), "cores": os.cpu_count()},
        "states": dict(Counter(entry["state"] for entry in listed)),
        "runs": listed,
    }
