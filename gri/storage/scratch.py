"""Folders for a short time where the system keeps temporary files. What killed commands left there is removed.

A process that is killed removes nothing. So each folder holds a locked file. The system gives the lock back when the
process ends, however it ends; the next folder that a process of the same user makes removes those without a lock.
"""

import os
import tempfile
import time
import weakref
from contextlib import suppress
from pathlib import Path
from shutil import rmtree

try:
    import fcntl
except ImportError:  # Windows: what is left by a killed command stays
    fcntl = None

PREFIX = "gri-cosim-"
LOCK = ".lock"
IN_THE_MAKING = 3600.0  # [s] that a folder may be without a lock; it takes microseconds to lock it


class ScratchFolder(tempfile.TemporaryDirectory[str]):
    """A temporary folder that is removed afterwards; if this process is killed, by the next one that makes a folder."""

    def __init__(self) -> None:
        remove_abandoned()
        super().__init__(prefix=PREFIX)
        handle = os.open(Path(self.name, LOCK), os.O_RDWR | os.O_CREAT, 0o600)
        self._unlock = weakref.finalize(self, os.close, handle)
        with suppress(OSError):  # a full disk, or one without locks
            if fcntl is not None:
                fcntl.flock(handle, fcntl.LOCK_EX)
            os.write(handle, str(os.getpid()).encode())  # an empty file is one that is not locked yet

    def cleanup(self) -> None:
        """Remove the folder."""
        if os.name != "posix":
            self._unlock()  # Windows removes no open files
        super().cleanup()
        self._unlock()


def remove_abandoned() -> None:
    """Remove the folders of processes that have ended."""
    if fcntl is None:
        return
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):  # it is of another user, or another process removes it just now
            if not folder.is_symlink() and folder.stat().st_uid == os.getuid() and _is_abandoned(folder):
                rmtree(folder, ignore_errors=True)


def _is_abandoned(folder: Path) -> bool:
    assert fcntl is not None
    old = time.time() - folder.stat().st_mtime > IN_THE_MAKING
    try:
        handle = os.open(folder / LOCK, os.O_RDWR)
    except FileNotFoundError:
        return old
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return old or os.fstat(handle).st_size > 0
    except BlockingIOError:
        return False
    finally:
        os.close(handle)
