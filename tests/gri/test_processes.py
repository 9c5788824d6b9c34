"""Nobody goes on working for a command that has been stopped or killed."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

COMMAND = """\
import multiprocessing, os, sys, time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from gri.processes import end_group, end_with_parent, stop_like_ctrl_c


def begin(folder):
    "A worker that starts a copy of itself, and both work for ever."
    end_with_parent(group=True)
    copy = os.fork()
    Path(folder, f"{os.getpid()}.pid").touch()
    time.sleep(1000)


def sleep(folder):
    Path(folder, f"{os.getpid()}.pid").touch()
    time.sleep(1000)


if __name__ == "__main__":
    stop_like_ctrl_c()
    context, folder = multiprocessing.get_context("spawn"), sys.argv[1]
    process = context.Process(target=begin, args=(folder,))
    process.start()
    pool = ProcessPoolExecutor(1, context, end_with_parent)
    try:
        pool.submit(sleep, folder).result()
    except KeyboardInterrupt:
        end_group(process)
        for worker in pool._processes.values():
            worker.terminate()
        pool.shutdown()
        process.join()
        sys.exit(130)
"""


@pytest.fixture
def command(tmp_path: Path):
    """A running command and its three workers: one of a pool, one that leads a group, and a copy of that."""
    (tmp_path / "command.py").write_text(COMMAND)
    started = subprocess.Popen([sys.executable, "command.py", str(tmp_path)], cwd=tmp_path)
    workers = _appearing(tmp_path, 3)
    yield started, workers
    for pid in (started.pid, *workers):
        _kill(pid)
    started.wait()


def test_a_stopped_command_ends_as_after_ctrl_c(command):
    started, workers = command
    started.terminate()
    assert started.wait(30) == 130
    assert not _left(workers)


def test_the_workers_of_a_killed_command_end(command):
    started, workers = command
    started.kill()
    started.wait(30)
    assert not _left(workers)


def test_an_ignored_signal_stays_ignored():
    program = (
        "import signal; from gri.processes import stop_like_ctrl_c; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "stop_like_ctrl_c(); print(signal.getsignal(signal.SIGHUP) is signal.SIG_IGN)"
    )
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "True\n"


def _appearing(folder: Path, count: int) -> list[int]:
    deadline = time.monotonic() + 60
    while len(found := list(folder.glob("*.pid"))) < count:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return [int(path.stem) for path in found]


def _left(workers: list[int]) -> list[int]:
    """The workers that are still there after a while; ended ones that nobody has collected do not count."""
    deadline = time.monotonic() + 30
    while (left := [pid for pid in workers if _works(pid)]) and time.monotonic() < deadline:
        time.sleep(0.05)
    return left


def _works(pid: int) -> bool:
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True).stdout.strip()
    return bool(state) and not state.startswith("Z")


def _kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
