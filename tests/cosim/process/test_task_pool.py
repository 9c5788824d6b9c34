"""Workers on this machine: every task ends with one answer, whatever it does to its process."""

import os
import signal
import time
from collections import Counter
from pathlib import Path

from cosim.process.task_pool import run_local
from tests.cosim.process.conftest import tasks


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


def test_faults_cost_their_own_task_only(tmp_path):
    names = ["fine", "crash", "fine", "murder", "exit", "fine", "hang", "fine"]
    answers = list(run_local(tasks(tmp_path, *names), 3.0, workers=2))
    assert Counter((answer.name.split("-")[0], answer.kind) for answer in answers) == {
        ("fine", "done"): 4, ("crash", "died"): 1, ("murder", "died"): 1, ("exit", "died"): 1, ("hang", "timeout"): 1,
    }  # fmt: skip
    message = {answer.name.split("-")[0]: answer.message for answer in answers}
    assert "SIGSEGV" in message["crash"]
    assert "SIGKILL" in message["murder"]
    assert "exit code 3" in message["exit"]
    assert "not finished after 3 s" in message["hang"]
    assert all("the last straw" in message[name] for name in ("crash", "murder", "exit", "hang"))
    assert all(gone(pid) for pair in pids(tmp_path) for pid in pair)


def test_an_answer_carries_the_value_and_its_cost(tmp_path):
    answers = {answer.name: answer for answer in run_local(tasks(tmp_path, "fine", "fine"), 60.0, workers=1)}
    assert {name: answer.value for name, answer in answers.items()} == {"fine-0": 0, "fine-1": 10}
    for answer in answers.values():
        assert (answer.kind, answer.message) == ("done", "")
        assert 0.02 < answer.cpu_seconds < 5
        assert answer.peak_mb > 5
        assert answer.seconds > 0.04


def test_exceptions_become_answers_and_stand_in_the_log(tmp_path):
    answers = {answer.kind + answer.name[0]: answer for answer in run_local(
        tasks(tmp_path, "refuse", "raise", "full"), 60.0, workers=1
    )}  # fmt: skip
    assert answers["inputr"].message == "no such net; last lines of its log: Error: the last straw"
    assert answers["errorr"].message.startswith("ZeroDivisionError: oh; last lines of its log: ")
    assert "ZeroDivisionError" in (tmp_path / "raise-1/sumo.log").read_text()
    assert answers["errorf"].message.startswith("No space left on device (OSError)")


def test_every_task_has_a_process_of_its_own(tmp_path):
    list(run_local(tasks(tmp_path, *["fine"] * 6), 60.0, workers=2))
    own, workers = zip(*pids(tmp_path), strict=True)
    assert len(set(own)) == 6
    assert len(set(workers)) == 2
    assert os.getpid() not in own + workers


def test_the_queue_may_grow_between_answers(tmp_path):
    queue, seen = tasks(tmp_path, "fine"), []
    for answer in run_local(queue, 60.0, workers=2):
        seen.append(answer.name)
        if len(seen) < 4:
            (tmp_path / str(len(seen))).mkdir()
            queue.extend(tasks(tmp_path / str(len(seen)), "fine"))
    assert len(seen) == 4


def test_leaving_early_leaves_no_process(tmp_path):
    answers = run_local(tasks(tmp_path, "fine", "hang", "hang"), 60.0, workers=2)
    assert next(answers).kind == "done"
    time.sleep(0.5)
    answers.close()
    assert len(pids(tmp_path)) >= 2
    assert all(gone(pid) for pair in pids(tmp_path) for pid in pair)


def test_workers_end_with_the_command_even_if_it_is_killed(tmp_path):
    pid = os.fork()
    if not pid:
        try:
            list(run_local(tasks(tmp_path, "hang"), 600.0, workers=1))
        finally:
            os._exit(0)
    for _ in range(600):
        if pids(tmp_path):
            break
        time.sleep(0.05)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    assert all(gone(pid) for pair in pids(tmp_path) for pid in pair)
