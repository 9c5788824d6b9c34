"""Temporary folders are removed afterwards, and those of killed processes by the next process that makes one."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from gri.storage.scratch import IN_THE_MAKING, LOCK, PREFIX, ScratchFolder, remove_abandoned

HOLDER = """
import time
from pathlib import Path
from gri.storage.scratch import ScratchFolder
with ScratchFolder() as folder:
    Path(folder, "large").write_bytes(b"0" * 1000)
    print(folder, flush=True)
    time.sleep(60)
"""


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A place of its own for temporary files."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    return tmp_path


def test_a_folder_is_there_and_then_gone(place: Path):
    with ScratchFolder() as name:
        folder = Path(name)
        assert folder.parent == place
        assert folder.is_dir()
        Path(folder, "file").write_text("text")
    assert not [*place.iterdir()]
    folder = ScratchFolder()
    assert [*place.iterdir()] == [Path(folder.name)]
    folder.cleanup()
    folder.cleanup()
    assert not [*place.iterdir()]


def test_what_a_killed_process_left_is_removed_by_the_next_and_not_before(place: Path):
    with subprocess.Popen([sys.executable, "-c", HOLDER], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        folder = Path(holder.stdout.readline().strip())
        with ScratchFolder() as mine:
            assert sorted(place.iterdir()) == sorted([folder, Path(mine)]), "it is in use"
        holder.send_signal(signal.SIGKILL)
    assert (folder / "large").exists(), "a killed process removes nothing"
    with ScratchFolder() as mine:
        assert [*place.iterdir()] == [Path(mine)]


FORKED = """
import os, sys
from gri.storage.scratch import ScratchFolder
folder = ScratchFolder()
if os.fork():
    print(folder.name, flush=True)
else:
    sys.stdin.read()
os._exit(0)
"""


def test_a_folder_lives_as_long_as_a_fork_of_its_process(place: Path):
    command = [sys.executable, "-c", FORKED]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as first:
        assert first.stdin is not None
        assert first.stdout is not None
        folder = Path(first.stdout.readline().strip())
        assert first.wait(60) == 0
        remove_abandoned()
        assert folder.exists(), "the fork of the ended process may use it"
        first.stdin.close()
        assert not first.stdout.read(), "the fork has ended"
    remove_abandoned()
    assert not [*place.iterdir()]


def test_a_folder_in_the_making_and_what_others_made_stay(place: Path):
    making, unlocked, other = (place / name for name in (f"{PREFIX}1", f"{PREFIX}2", "other-3"))
    for folder in (making, unlocked, other):
        folder.mkdir()
    (making / LOCK).touch()
    link = place / f"{PREFIX}link"
    link.symlink_to(other)
    remove_abandoned()
    assert sorted(place.iterdir()) == sorted([making, unlocked, other, link])
    long_ago = time.time() - IN_THE_MAKING - 10
    for folder in (making, unlocked, other):
        os.utime(folder, (long_ago, long_ago))
    remove_abandoned()
    assert sorted(place.iterdir()) == sorted([other, link])
