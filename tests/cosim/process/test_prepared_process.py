"""Tasks that share a preparation: it is entered once, and each task is done in a copy of its process."""

import os
from collections import Counter, deque
from dataclasses import replace
from pathlib import Path

import pytest

from cosim.process.fork import CAN_FORK
from cosim.process.task import Preparation, Task, TaskResult
from cosim.process.task_pool import Worker, key_of, next_task, run_local
from tests.cosim.process.conftest import tasks
from tests.cosim.process.test_task_pool import gone, pids

pytestmark = pytest.mark.skipif(not CAN_FORK, reason="this system cannot fork")


def prepared(folder: Path, *kinds: tuple[str, str]) -> deque[Task]:
    """A task for each pair of its kind and its preparation."""
    alone = tasks(folder, *(kind for kind, _ in kinds))
    shared = [Preparation(what, "faults:prepare", (what,)) for _, what in kinds]
    return deque(replace(task, preparation=of) for task, of in zip(alone, shared, strict=True))


def done(queue: deque[Task], workers: int = 1, limit: float = 60.0) -> list[TaskResult]:
    return sorted(run_local(queue, limit, workers=workers), key=lambda answer: int(answer.name.split("-")[1]))


def test_it_is_entered_once_per_key_and_each_task_is_a_copy(tmp_path):
    """Tasks for which the worker is prepared go first."""
    answers = done(prepared(tmp_path, ("fine", "one"), ("fine", "two"), ("fine", "one"), ("fine", "two")))
    processes = [answer.value[0] for answer in answers]
    assert processes[0] == processes[2] != processes[1] == processes[3]
    assert all(process == parent for process, parent in (answer.value for answer in answers))
    own, _ = zip(*pids(tmp_path), strict=True)
    assert len(set(own)) == 4


def test_workers_take_their_own_key_and_then_one_that_nobody_has(tmp_path):
    queue = prepared(tmp_path, *(("fine", what) for what in ("one", "two", "one", "three", "two")))
    first, second = (Worker.__new__(Worker) for _ in range(2))
    first.key = second.key = ""
    taken = []
    for worker in (first, second, first, first, second):
        others = {other.key for other in (first, second) if other is not worker}
        worker.key = key_of(task := next_task(queue, worker.key, others))
        taken.append(task.name)
    assert taken == ["fine-0", "fine-1", "fine-2", "fine-3", "fine-4"]
    assert (first.key, second.key, len(queue)) == ("three", "two", 0)


def test_where_it_fails_tasks_are_done_without_it(tmp_path):
    answers = done(prepared(tmp_path, ("fine", "fails"), ("refuse", "fails"), ("fine", "works")))
    assert [answer.kind for answer in answers] == ["done", "input", "done"]
    assert answers[0].value == 0
    assert answers[2].value != 20


def test_where_it_crashes_its_own_tasks_die(tmp_path):
    answers = done(prepared(tmp_path, ("fine", "crashes"), ("fine", "works")))
    assert answers[0].kind == "died"
    assert "SIGSEGV" in answers[0].message
    assert answers[-1].kind == "done"


def test_faults_cost_their_own_task_only(tmp_path):
    kinds = ["fine", "crash", "fine", "murder", "exit", "fine", "hang", "fine"]
    answers = done(prepared(tmp_path, *((kind, "one") for kind in kinds)), limit=3.0)
    assert Counter((answer.name.split("-")[0], answer.kind) for answer in answers) == {
        ("fine", "done"): 4, ("crash", "died"): 1, ("murder", "died"): 1, ("exit", "died"): 1, ("hang", "timeout"): 1,
    }  # fmt: skip
    assert all(gone(pid) for pair in pids(tmp_path) for pid in pair)


def test_leaving_early_leaves_no_process(tmp_path):
    answers = run_local(prepared(tmp_path, ("fine", "one"), ("hang", "one")), 60.0, workers=1)
    process = next(answers).value[0]
    answers.close()
    assert gone(process)
    assert os.getpid() != process
