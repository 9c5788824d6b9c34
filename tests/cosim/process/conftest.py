"""Tasks that fail in every way."""

from collections import deque
from pathlib import Path

import pytest

from cosim.process.task import Task

FAULTS = '''
import os, signal, time
from contextlib import contextmanager
from gri.errors import InputError

@contextmanager
def prepare(what):
    """The process in which this was entered, unless it fails."""
    if what == "fails":
        raise InputError("cannot be prepared")
    if what == "crashes":
        os.kill(os.getpid(), signal.SIGSEGV)
    yield os.getpid()

def act(folder, kind, number, prepared=None):
    """Do what `kind` says; `prepared` is the value of the preparation."""
    print("Error: the last straw", flush=True)
    (folder / "pid").write_text(f"{os.getpid()} {os.getppid()}")
    if kind == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if kind == "hang":
        time.sleep(600)
    if kind == "murder":
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(600)
    if kind == "exit":
        os._exit(3)
    if kind == "refuse":
        raise InputError("no such net")
    if kind == "raise":
        raise ZeroDivisionError("oh")
    if kind == "full":
        raise OSError(28, "No space left on device")
    began = time.process_time()
    while time.process_time() - began < 0.05:
        pass
    return 10 * number if prepared is None else (prepared, os.getppid())
'''


@pytest.fixture(autouse=True)
def faults(tmp_path, monkeypatch):
    """A stand-in for the work, in a module that spawned processes find, too."""
    (tmp_path / "faults.py").write_text(FAULTS)
    monkeypatch.syspath_prepend(tmp_path)


def tasks(folder: Path, *kinds: str) -> deque[Task]:
    return deque(Task(f"{kind}-{k}", "faults:act", (kind, k), folder / f"{kind}-{k}") for k, kind in enumerate(kinds))
