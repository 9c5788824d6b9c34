"""Running what is left of a batch: which runs, how many attempts, and the records of them."""

import os
import platform
import shutil
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec

from cosim.batch.run_matrix import PACKAGES, Run
from cosim.batch.spec import Batch
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
    with store.opened(by_id, warn):
        if retry:
            store.forget_failures()
        done, failed = store.finished() & set(by_id), set(store.failures()) & set(by_id)
        tally = Tally(len(runs), len(done), len(failed - done))
        attempts: Counter[str] = Counter()
        reasons: dict[str, list[dict[str, Any]]] = {}
        left = [run for run in runs if run.id not in done | failed]
        warm_ups = _shared_warm_ups(left, store.scratch)
        queue = deque(_task(run, store, 0, warm_ups) for run in sorted(left, key=lambda run: warm_ups[run.id][0]))
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
                    else:
                        reasons.setdefault(run.id, []).append({"kind": answer.kind, "message": answer.message})
                        if answer.kind not in NOT_RETRIED and attempts[run.id] <= batch.retries:
                            queue.append(_task(run, store, attempts[run.id], warm_ups))
                        else:
                            _write_record(partial(store.fail, run.id, _failure(run, reasons[run.id])), warn)
                            tally = replace(tally, failed=tally.failed + 1)
                    _write_record(partial(store.log, _log_entry(answer, attempts[run.id])), warn)
                    tell(tally)
        finally:
            store.sweep()
            record()
        return tally


WarmUps = Mapping[str, tuple[int, Preparation | None]]
"""By the id of a run: its place in the queue, the same for all that share a warm-up, and the warm-up."""


def _shared_warm_ups(runs: Sequence[Run], scratch: Path) -> WarmUps:
    """The warm-ups that several runs share, with their files in `scratch`; runs alone have none."""
    keys = [warm_up_key(run.scenario) for run in runs]
    count, place, found = Counter(keys), {key: k for k, key in reversed([*enumerate(keys)])}, {}
    for k, (run, key) in enumerate(zip(runs, keys, strict=True)):
        if key and count[key] > 1:
            preparation = Preparation(key, "cosim.runs.shared_warm_up:shared_warm_up", (run.scenario, str(scratch)))
            found[run.id] = place[key], preparation
        else:
            found[run.id] = k, None
    return found


def _task(run: Run, store: BatchStore, attempt: int, warm_ups: WarmUps) -> Task:
    arguments, preparation = (run.scenario, msgspec.to_builtins(run.cell), run.key), warm_ups[run.id][1]
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
    if answer.kind != "done":
        shutil.rmtree(answer.folder, ignore_errors=True)
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
    finished, failures = store.finished(), store.failures()
    listed = []
    for run in runs:
        state = "done" if run.id in finished else "failed" if run.id in failures else "open"
        entry: dict[str, Any] = {"run": run.id, "key": run.key, **msgspec.to_builtins(run.cell), "state": state}
        if state == "done":
            own = read_manifest(store.run_folder(run.id))
            starts = own.get("arguments", {}).get("starts", run.scenario.episodes)
            entry |= {"results": own.get("results", {}), "starts": starts, "asked": run.scenario.episodes}
        listed.append(entry)
    return {
        "file": str(file),
        "batch": msgspec.to_builtins(batch),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
        "machine": {"system": platform.system(), "processor": platform.machine(), "cores": os.cpu_count()},
        "states": dict(Counter(entry["state"] for entry in listed)),
        "runs": listed,
    }
