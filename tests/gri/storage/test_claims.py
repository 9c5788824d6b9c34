"""A folder or a place belongs to one process at a time."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from gri.errors import InputError
from gri.storage import claims
from gri.storage.claims import claimed_folder, claimed_place, is_claimed

HOLD = """
import sys, time
from pathlib import Path
from gri.storage import claims
from gri.storage.claims import claimed_folder
with claimed_folder(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("claim", [claimed_folder, claimed_place])
def test_two_claims_at_once_are_refused_in_one_line(tmp_path, claim):
    target = tmp_path / "run"
    with (
        claim(target),
        pytest.raises(InputError, match=rf"run: `.*` \(process {os.getpid()} on .*, since 2.*\+00:00\) writes there"),
        claim(target),
    ):
        pass
    with claim(target):  # free again
        pass
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_place_is_claimed_only_meanwhile(tmp_path):
    assert not is_claimed(tmp_path / "run")
    with claimed_place(tmp_path / "run"):
        assert is_claimed(tmp_path / "run")
        assert not is_claimed(tmp_path / "run-2")
    assert not is_claimed(tmp_path / "run")


def test_the_claim_of_a_killed_process_is_none(tmp_path):
    """Its file stays and names a process; the system has given the lock back."""
    command = [sys.executable, "-c", HOLD, str(tmp_path / "run")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(InputError, match=f"process {holder.pid} on"), claimed_folder(tmp_path / "run"):
            pass
        (tmp_path / "run/.x.1-abc.part").mkdir()
        holder.send_signal(signal.SIGKILL)
        holder.wait()
    assert json.loads((tmp_path / "run/.lock").read_text())["process"] == holder.pid
    with claimed_folder(tmp_path / "run"):
        assert os.listdir(tmp_path / "run") == [".lock"]
    assert os.listdir(tmp_path / "run") == []


def test_a_claim_without_a_readable_record_still_holds(tmp_path):
    with claimed_folder(tmp_path):
        (tmp_path / ".lock").write_bytes(b"\xff")
        with pytest.raises(InputError, match="another command writes there"), claimed_folder(tmp_path):
            pass


def test_the_longer_record_of_a_killed_process_is_overwritten(tmp_path):
    (tmp_path / ".lock").write_text(json.dumps({"command": "x" * 500}))
    with claimed_folder(tmp_path):
        assert json.loads((tmp_path / ".lock").read_text())["process"] == os.getpid()


def test_everybody_may_read_who_holds_a_claim(tmp_path):
    before = os.umask(0o022)
    try:
        with claimed_folder(tmp_path):
            assert (tmp_path / ".lock").stat().st_mode & 0o777 == 0o644
    finally:
        os.umask(before)


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="needs /proc")
def test_a_claim_that_ends_while_another_waits_leaves_a_new_file(tmp_path, monkeypatch):
    """Between opening and locking the file, its holder removes it: the lock of a file that is gone holds nothing."""
    lock, seen = tmp_path / ".lock", claims._is_same
    before = len(os.listdir("/proc/self/fd"))

    def removed_at_first(handle: int, path: Path) -> bool:
        monkeypatch.setattr(claims, "_is_same", seen)
        path.unlink()
        return seen(handle, path)

    monkeypatch.setattr(claims, "_is_same", removed_at_first)
    with claimed_folder(tmp_path):
        assert json.loads(lock.read_text())["process"] == os.getpid()
        assert len(os.listdir("/proc/self/fd")) == before + 1
        with pytest.raises(InputError, match="writes there"), claimed_folder(tmp_path):
            pass
    assert not lock.exists()


def test_claims_make_their_folders_and_leave_other_files_alone(tmp_path):
    with claimed_place(tmp_path / "a/b/run"):
        (tmp_path / "a/b/.other.1-abc.part").touch()
        (tmp_path / "a/b/.run.1-abc.part").touch()
    with claimed_place(tmp_path / "a/b/run"):
        assert sorted(os.listdir(tmp_path / "a/b")) == [".other.1-abc.part", ".run.lock"]
    with claimed_folder(tmp_path / "c/d"):
        assert os.listdir(tmp_path / "c/d") == [".lock"]
    with claimed_folder(tmp_path / "c/d"):
        pass


def test_systems_without_file_locks_have_no_claims(tmp_path, monkeypatch):
    monkeypatch.setattr(claims, "fcntl", None)
    with claimed_place(tmp_path / "run"):
        assert not is_claimed(tmp_path / "run")
        with claimed_place(tmp_path / "run"):
            pass


def test_a_disk_that_cannot_lock_is_said(tmp_path, monkeypatch):
    def no_locks(*_: int) -> None:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(claims.fcntl, "flock", no_locks)
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises(InputError, match=r"cannot claim .*: Function not implemented; give an --out on another disk"):
        claimed_folder(tmp_path / "run").__enter__()
    assert len(os.listdir("/proc/self/fd")) == before
    (tmp_path / ".run.lock").touch()
    assert not is_claimed(tmp_path / "run")


def test_where_nothing_can_be_written_nothing_can_be_claimed(tmp_path):
    (tmp_path / "file").touch()
    for claim in (claimed_folder, claimed_place):
        with pytest.raises(InputError, match=re.escape(f"cannot write to {tmp_path}/file/run: ")):
            claim(tmp_path / "file/run").__enter__()


@pytest.mark.parametrize(
    ("words", "command"),
    [(["/x/cosim/__main__.py", "run", "a.yaml"], "cosim run"), (["/bin/gri", "train", "a"], "gri train"), (["x"], "x")],
)
def test_a_claim_says_which_command_holds_it(tmp_path, monkeypatch, words, command):
    monkeypatch.setattr(sys, "argv", words)
    with claimed_folder(tmp_path):
        assert json.loads((tmp_path / ".lock").read_text())["command"] == command


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="needs /proc")
def test_refused_claims_leave_no_descriptor_open(tmp_path):
    with claimed_folder(tmp_path):
        before = len(os.listdir("/proc/self/fd"))
        for _ in range(5):
            with pytest.raises(InputError), claimed_folder(tmp_path):
                pass
        assert len(os.listdir("/proc/self/fd")) == before
