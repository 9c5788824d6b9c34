"""Every wait on another process ends, and says what it waited for."""

import os
import signal
import time

import pytest

from cosim.process import fork as forking
from cosim.process.fork import BranchError, fork, fork_and_send
from cosim.process.worker_process import WorkerError, run_in_worker


def silent(tell, pause):
    """Says something once, then nothing."""
    tell("warm-up", 3, 60)
    time.sleep(pause)


def test_a_worker_that_reports_nothing_is_ended(tmp_path):
    began = time.monotonic()
    with pytest.raises(WorkerError, match=r"waited 1 s for progress of silent after warm-up 3 60, then ended it"):
        run_in_worker(
            f"{__name__}:silent", log=tmp_path / "log", tell=lambda *_: None, options={"pause": 60}, silence=1.0
        )
    assert time.monotonic() - began < 50


@pytest.mark.parametrize("jump", [-1e9, 0.0, 1e9], ids="{:+g} s".format)
def test_a_copy_that_does_not_answer_is_ended_whatever_the_clock_says(monkeypatch, jump):
    clock, readings = time.time, iter(range(10**9))
    monkeypatch.setattr(time, "time", lambda: clock() + next(readings) % 2 * jump)
    branch = fork(lambda: time.sleep(60))
    with pytest.raises(BranchError, match=rf"waited 0.3 s for the branched simulation \(process {branch.pid}\)"):
        branch.result(0.3)
    with pytest.raises(ChildProcessError):
        os.waitpid(branch.pid, 0)  # nothing is left of it


def test_a_large_answer_comes_whole():
    assert fork(lambda: "x" * 5_000_000).result(30.0) == "x" * 5_000_000


def test_a_copy_ends_when_nobody_can_send_it_its_argument(monkeypatch, tmp_path):
    """The original dies before it sends; another copy holds the pipe open, so its end is not noticed by reading."""
    monkeypatch.setattr(forking, "PARENT_CHECKED_EVERY", 0.1)

    def original() -> None:
        copy, _ = fork_and_send(lambda message: message)
        holder = fork(lambda: time.sleep(60))
        (tmp_path / "pids.new").write_text(f"{copy.pid} {holder.pid}")
        (tmp_path / "pids.new").rename(tmp_path / "pids")  # and this process ends without sending

    branch, deadline = fork(original), time.monotonic() + 40
    while not (tmp_path / "pids").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    os.waitpid(branch.pid, 0)
    copy, holder = map(int, (tmp_path / "pids").read_text().split())
    while _lives(copy) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert _lives(holder)
    assert not _lives(copy)
    os.kill(holder, signal.SIGKILL)
    os.close(branch.pipe)


def _lives(process: int) -> bool:
    try:
        with open(f"/proc/{process}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
