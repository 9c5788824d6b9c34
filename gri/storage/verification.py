"""Finished results are compared with their hashes before they are used, so damaged ones are never taken for results.

A JSON file of results is *sealed*: its last field is the hash of all others. It may name the hashes of files beside it.
"""

import hashlib
import time
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import msgspec

from gri.errors import InputError, guarded_reading
from gri.storage.whole_files import write_whole

SEAL = "own_sha256"
"""The field of a sealed JSON file: SHA-256 of everything else in it, written as JSON with sorted names."""


JUST_NOW = 5.0
"""[s] Much more than the resolution of the times of files."""
VALUE = "value"
"""The only other field of a sealed file of a value that has no fields of its own, such as a list."""


class DamagedError(InputError):
    """A file of results is not what was written."""


def digest(path: Path) -> str:
    """SHA-256 of a file's content. It is computed again only when the file's identity, size or times have changed.

    A file that was written just now is always read: it could be written again without a change of its time. The time of
    its last change counts besides that of its content, which programs set, and which a clock that was put back repeats.
    """
    found = path.stat()
    if abs(time.time() - found.st_mtime) < JUST_NOW:
        return _content_hash(path)
    return _digest(path, found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)


@lru_cache(maxsize=10_000)
def _digest(path: Path, *_: int) -> str:
    return _content_hash(path)


def _content_hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_digest(path: Path, wanted: str | None, fix: str) -> Path:
    """The path of a file that has this hash. Errors: `DamagedError` if it is missing, or has another one."""
    try:
        found = digest(path)
    except OSError as error:
        raise DamagedError(f"{path}: cannot be read ({error.strerror}); {fix}") from None
    if found != wanted:
        raise DamagedError(f"{path}: is damaged (its SHA-256 hash is not the recorded one); {fix}")
    return path


def digest_file(path: Path) -> Path:
    """The file beside a single file of results that holds its hash, as `sha256sum` writes and checks it."""
    return path.with_name(f"{path.name}.sha256")


def write_digest(path: Path) -> None:
    """Write the hash of a finished file beside it."""
    write_whole(digest_file(path), f"{digest(path)}  {path.name}\n")


def check_own_digest(path: Path, fix: str) -> Path:
    """The path of a file that has the hash beside it, or has none beside it. Errors: `DamagedError`."""
    recorded = digest_file(path)
    if not recorded.is_file() or not path.is_file():
        return path
    with guarded_reading(recorded, "file of a hash", fix):
        wanted = recorded.read_text().split()[0]
    return check_digest(path, wanted, fix)


def sealed(content: Mapping[str, Any], enc_hook: Callable[[Any], Any] | None = None) -> dict[str, Any]:
    """The content as plain values of JSON, with its own hash as the last field."""
    plain = msgspec.json.decode(msgspec.json.encode(content, enc_hook=enc_hook))
    plain.pop(SEAL, None)
    return plain | {SEAL: _own_hash(plain)}


def write_sealed(path: Path, content: Mapping[str, Any], enc_hook: Callable[[Any], Any] | None = None) -> None:
    """Write a sealed JSON file that appears whole or not at all."""
    write_whole(path, msgspec.json.format(msgspec.json.encode(sealed(content, enc_hook)), indent=2) + b"\n")


def read_sealed(path: Path, fix: str) -> dict[str, Any]:
    """The content of a sealed JSON file without its hash; files of older versions, which have none, are read as well.

    Errors: `DamagedError` if it has been changed, `InputError` if it is no JSON.
    """
    with guarded_reading(path, "JSON file of results", fix):
        content = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    seal = content.pop(SEAL, None)
    if seal is not None and seal != _own_hash(content):
        raise DamagedError(f"{path}: is damaged (its content does not have the hash {SEAL}); {fix}")
    return content


def read_value(path: Path, fix: str) -> Any:
    """The value of a sealed file `{VALUE: value}`, or the whole content of a file of an older version."""
    with guarded_reading(path, "JSON file of results", fix):
        content = msgspec.json.decode(path.read_bytes())
    if not isinstance(content, dict) or not {VALUE, SEAL} & set(content):
        return content
    content = read_sealed(path, fix)
    if set(content) != {VALUE}:
        raise DamagedError(f"{path}: is damaged (its content is not in the field {VALUE}); {fix}")
    return content[VALUE]


def is_intact(path: Path, warn: Callable[[str], None]) -> bool:
    """Whether a sealed JSON file is there and undamaged.

    A damaged one is renamed, and `warn` is called with a sentence about it.
    """
    if not path.is_file():
        return False
    try:
        with guarded_reading(path, "JSON file of results", ""):
            content = msgspec.json.decode(path.read_bytes())
        if isinstance(content, dict):  # older versions wrote lists as well
            read_sealed(path, "")
    except InputError as error:
        warn(f"{str(error).partition(';')[0]}; it is made again, the old file is {set_aside(path)}")
        return False
    return True


def _own_hash(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(msgspec.json.encode(content, order="sorted")).hexdigest()


def set_aside(path: Path) -> Path:
    """Rename a damaged file or folder to a free name beside it, so that it is out of the way and can be looked at."""
    names = (path.with_name(f"{path.name}.damaged{f'-{k}' if k > 1 else ''}") for k in range(1, 10**6))
    aside = next(name for name in names if not name.exists())
    path.rename(aside)
    return aside
