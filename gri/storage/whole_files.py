"""Files and folders that appear whole or not at all: written beside their place, flushed to the disk, then renamed."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path

PART = ".part"  # how names of unfinished files and folders end


def part_beside(path: Path) -> Path:
    """A name beside `path` that no other process uses; hidden, and shorter than the 255 bytes of a file's name."""
    return path.with_name(f".{_short(path.name)}.{os.getpid()}-{secrets.token_hex(3)}{PART}")


def sweep(folder: Path, name: str | None = None) -> None:
    """Remove what killed commands left unfinished in a folder, or of one `name` in it. Only for its claimant."""
    for path in folder.glob(f".{escape(_short(name))}.*{PART}" if name else f".*{PART}"):
        remove(path)


def remove(path: Path) -> None:
    """Remove a file or a folder as far as that is possible."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A path to write a file to, which takes the place of `path` at the end; after an error nothing has changed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = part_beside(path)
    try:
        yield part
        publish(part, path)
    finally:
        part.unlink(missing_ok=True)


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file that appears whole or not at all. Text is written as UTF-8."""
    with whole_file(path) as part:
        part.write_bytes(content.encode() if isinstance(content, str) else content)


def publish(part: Path, path: Path) -> None:
    """Move a finished file or folder to its place once it is on the disk. A folder never replaces one with content."""
    for inner in sorted(part.rglob("*")) if part.is_dir() else ():
        _sync(inner)
    _sync(part)
    os.replace(part, path)
    _sync(path.parent)


def _sync(path: Path) -> None:
    """Flush a file to the disk; a folder as well, where the system can do that."""
    if path.is_symlink() or not (path.is_file() or path.is_dir()):
        return
    folder = path.is_dir()
    try:
        handle = os.open(path, os.O_RDONLY if folder or os.name == "posix" else os.O_RDWR)
    except OSError:
        if folder:  # Windows opens no folders
            return
        raise
    try:
        os.fsync(handle)
    except OSError:
        if not folder:
            raise
    finally:
        os.close(handle)


def _short(name: str) -> str:
    """A name that leaves room for the rest of the name of an unfinished file."""
    return name.encode()[:200].decode(errors="ignore")
