"""Workers on this machine: every task ends with one answer, whatever it does to its process."""

import os
import signal
import time
from collections import Counter, deque
from pathlib import Path

import pytest

from cosim.process.task import Task
from cosim.process.task_pool import run_local
from cosim.spec.loading import load_scenario

FAULTS = '''
import os, signal, time
from cosim.process.task import Answer

def perform(task):
    """Do what the name of the run says."""
    task.folder.mkdir()
    (task.folder / "sumo.log").write_text("Error: the last straw")
    (task.folder / "pid").write_text(f"{os.getpid()} {os.getppid()}")
    what = task.run.split("-")[0]
    if what == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if what == "hang":
        time.sleep(600)
    if what == "murder":
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(600)
    if what == "exit":
        os._exit(3)
    time.sleep(0.05)
    return Answer(task.run, task.folder, "done")
'''


@pytest.fixture
def perform(tmp_path, monkeypatch):
    """A stand-in for a run, in a module that spawned processes find, too."""
    (tmp_path / "faults.py").write_text(FAULTS)
    monkeypatch.syspath_prepend(tmp_path)
    return "faults:perform"


def tasks(folder: Path, *names: str) -> deque[Task]:
    scenario = load_scenario("us101_car_following")
    return deque(Task(f"{name}-{k}", scenario, {}, "", folder / f"{name}-{k}") for k, name in enumerate(names))


def pids(folder: Path) -> list[list[int]]:
    return [[int(pid) for pid in path.read_text().split()] for path in folder.glob("*/pid")]


def gone(pid: int) -> bool:
    for _ in range(100):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def test_faults_cost_their_own_task_only(tmp_path, perform):
    names = ["fine", "crash", "fine", "murder", "exit", "fine", "hang", "fine"]
    answers = list(run_local(tasks(tmp_path, *names), 3.0, workers=2, perform=perform))
    assert Counter((answer.run.split("-")[0], answer.kind) for answer in answers) == {
        ("fine", "done"): 4, ("crash", "died"): 1, ("murder", "died"): 1, ("exit", "died"): 1, ("hang", "timeout"): 1,
    }  # fmt: skip
    told = {answer.run.split("-")[0]: answer.message for answer in answers}
    assert "SIGSEGV" in told["crash"]
    assert "SIGKILL" in told["murder"]
    assert "exit code 3" in told["exit"]
    assert "not finished after 3 s" in told["hang"]
    assert all("the last straw" in told[name] for name in ("crash", "murder", "exit", "hang"))
    assert all(gone(pid) for pair in pids(tmp_path) for pid in pair)


def test_every_task_has_a_process_of_its_own(tmp_path, perform):
    list(run_local(tasks(tmp_path, *["fine"] * 6), 60.0, workers=2, perform=perform))
    own, workers = zip(*pids(tmp_path), strict=True)
    assert len(set(own)) == 6
    assert len(set(workers)) == 2
    assert os.getpid() not in own + workers


def test_the_queue_may_grow_between_answers(tmp_path, perform):
    queue, seen = tasks(tmp_path, "fine"), []
    for answer in run_local(queue, 60.0, workers=2, perform=perform):
        seen.append(answer.run)
        if len(seen) < 4:
            (tmp_path / str(len(seen))).mkdir()
            queue.extend(tasks(tmp_path / str(len(seen)), "fine"))
    assert len(seen) == 4


def test_leaving_early_leaves_no_process(tmp_path, perform):
    answers = run_local(tasks(tmp_path, "fine", "hang", "hang"), 60.0, workers=2, perform=perform)
    assert next(answers).kind == "done"
    time.sleep(0.5)
    answers.close()
    assert len(pids(tmp_path)) >= 2
    assert all(gone(pid) for pair in pids(tmp_path) for pid in pair)


def test_workers_end_with_the_command_even_if_it_is_killed(tmp_path, perform):
    pid = os.fork()
    if not pid:
        try:
            list(run_local(tasks(tmp_path, "hang"), 600.0, workers=1, perform=perform))
        finally:
            os._exit(0)
    for _ in range(600):
        if pids(tmp_path):
            break
        time.sleep(0.05)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    assert all(gone(pid) for pair in pids(tmp_path) for pid in pair)
