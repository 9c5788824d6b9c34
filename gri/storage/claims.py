"""A folder or file of results belongs to one command at a time.

A claim is a lock on a small file that says who holds it. The system gives the lock back when the process ends, however
it ends, so what a killed command leaves is no claim; the next command takes the file over and removes it.
"""

import json
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gri.errors import InputError
from gri.storage.whole_files import sweep

try:
    import fcntl
except ImportError:  # Windows: two commands on one folder are not noticed
    fcntl = None

LOCK = ".lock"


@contextmanager
def claimed_folder(folder: Path) -> Iterator[None]:
    """Make a folder where there is none, and hold it for this process; what killed commands left in it is removed.

    Errors: `InputError` if another command holds it, or if it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror}; give another --out") from None
    with _claimed(folder / LOCK, folder):
        sweep(folder)
        yield


@contextmanager
def claimed_place(path: Path) -> Iterator[None]:
    """Hold the place of a file or folder that is not there yet, or about to be replaced; else like `claimed_folder`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot write to {path}: {error.strerror}; give another --out") from None
    with _claimed(_lock_of(path), path):
        sweep(path.parent, path.name)
        yield


def is_claimed(path: Path) -> bool:
    """Whether a command holds the place of a file or folder just now."""
    if fcntl is None or not (lock := _lock_of(path)).is_file():
        return False
    with suppress(OSError), lock.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _lock_of(path: Path) -> Path:
    return path.with_name(f".{path.name}{LOCK}")


@contextmanager
def _claimed(lock: Path, wanted: Path) -> Iterator[None]:
    handle = _locked(lock, wanted)
    try:
        with suppress(OSError):  # on a full disk the claim holds without its record
            os.truncate(handle, 0)
            os.write(handle, json.dumps(_record()).encode())
        yield
    finally:
        if fcntl is not None:
            with suppress(OSError):
                lock.unlink()  # while it is held: who waits for it notices that the file is another one
        os.close(handle)


def _locked(lock: Path, wanted: Path) -> int:
    """The opened and locked file of a claim."""
    while True:
        try:
            handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise InputError(f"cannot write to {wanted}: {error.strerror}; give another --out") from None
        if fcntl is None:
            return handle
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_same(handle, lock):
                return handle
            os.close(handle)  # its holder removed the file meanwhile; there may be a new one
        except BlockingIOError:
            holder = _holder(handle)
            os.close(handle)
            raise InputError(f"{wanted}: {holder} writes there; wait for it, stop it, or give another --out") from None
        except OSError as error:
            os.close(handle)
            raise InputError(f"cannot claim {wanted}: {error.strerror}; give an --out on another disk") from None


def _is_same(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except FileNotFoundError:
        return False


def _record() -> dict[str, Any]:
    program = Path(sys.argv[0])
    name = program.parent.name if program.name == "__main__.py" else program.name
    command = " ".join([name, *sys.argv[1:2]])
    since = datetime.now(UTC).isoformat(timespec="seconds")
    return {"command": command, "process": os.getpid(), "host": socket.gethostname(), "since": since}


def _holder(handle: int) -> str:
    """Who holds a claim, in words."""
    try:
        record = json.loads(os.read(handle, 10_000))
        return f"`{record['command']}` (process {record['process']} on {record['host']}, since {record['since']})"
    except (OSError, ValueError, KeyError, TypeError):  # it has not been written, or the disk is full
        return "another command"
