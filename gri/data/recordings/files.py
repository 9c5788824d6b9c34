"""What a person has: a file, a folder or a zip, plain or compressed, in some encoding, opened as streams of bytes.

Files that operating systems add to archives (`__MACOSX/`, `._name`, `.DS_Store`) are passed over.
"""

import gzip
import hashlib
import io
import re
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast

from gri.errors import InputError, guarded_reading

RATIO, SMALL = 200, 64 * 2**20  # unpacked bytes per byte of a file, and what is allowed in any case; text has 3 to 20
MOST_FILES = 10_000
DATA = re.compile(r"\.(csv|txt|tsv|dat|json|xml|parquet)(\.gz)?$", re.IGNORECASE)
"""Files of folders and archives that are looked at; data sets have pictures and papers beside them."""
JUNK = re.compile(r"(^|/)(__MACOSX/|\.[^/]*$|Thumbs\.db$|desktop\.ini$)", re.IGNORECASE)
FIX = "save the file again, or download it again"


@dataclass(frozen=True)
class Member:
    """A file, or a file inside a zip archive."""

    path: Path
    inside: str = ""
    """Name inside the archive; empty for a plain file."""

    def __str__(self) -> str:
        return f"{self.path}!{self.inside}" if self.inside else str(self.path)

    @property
    def name(self) -> str:
        """The name without folders and without `.gz`."""
        return re.sub(r"\.gz$", "", Path(self.inside or self.path).name, flags=re.IGNORECASE)

    @property
    def stem(self) -> str:
        """The name without its ending."""
        return self.name.partition(".")[0]

    def sibling(self, name: str) -> "Member":
        """The file of that name in the same folder; it need not exist."""
        if self.inside:
            return Member(self.path, str(Path(self.inside).with_name(name)))
        return Member(self.path.with_name(name))

    @contextmanager
    def open(self, what: str = "file", fix: str = FIX) -> Iterator[BinaryIO]:
        """The unpacked bytes; the boundary around whoever reads them (`guarded_reading`).

        Errors: `InputError` that says `what` was wanted if they cannot be read, or are far more than the file has.
        """
        with guarded_reading(str(self), what, fix), ExitStack() as stack:
            size = self.path.stat().st_size
            raw = cast(Any, stack.enter_context(self.path.open("rb")))
            if self.inside:
                archive = stack.enter_context(zipfile.ZipFile(raw))
                raw = stack.enter_context(archive.open(self.inside))
            stream = cast(BinaryIO, io.BufferedReader(cast(Any, raw)) if self.inside else raw)
            if stream.peek(2)[:2] == b"\x1f\x8b":  # type: ignore[attr-defined]
                stream = cast(BinaryIO, stack.enter_context(gzip.GzipFile(fileobj=stream)))
            yield cast(BinaryIO, io.BufferedReader(_Bounded(stream, size, str(self)), 1 << 20))

    @contextmanager
    def open_whole(self, what: str, fix: str = FIX) -> Iterator[BinaryIO]:
        """The unpacked bytes in memory, for formats that are read from their end (`open`)."""
        with self.open(what, fix) as stream:
            yield io.BytesIO(stream.read())

    def exists(self) -> bool:
        """Whether there is such a file."""
        if not self.inside:
            return self.path.is_file()
        with guarded_reading(self.path, "zip file", FIX), zipfile.ZipFile(self.path) as archive:
            return self.inside in archive.namelist()


class _Bounded(io.RawIOBase):
    """A stream that refuses contents that no recording has, before they fill the memory."""

    def __init__(self, stream: Any, size: int, where: str) -> None:
        self._stream, self._where, self._left = stream, where, max(RATIO * size, SMALL)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        part = self._stream.read(len(buffer))
        buffer[: len(part)] = part
        self._left -= len(part)
        if self._left < 0:
            raise InputError(f"{self._where}: unpacks to more than {RATIO} times its size; {FIX}")
        return len(part)


def _is_data(name: str) -> bool:
    return bool(DATA.search(name)) and not JUNK.search(name)


def _begins_as_zip(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(4) == b"PK\x03\x04"


def members(path: Path) -> list[Member]:
    """The files of a path: itself, those of a folder, or those of a zip archive, ordered by name.

    Errors: `InputError` if there is no such path, no file in it, or an archive that cannot be read.
    """
    if path.is_dir():
        inside = (p for p in sorted(path.rglob("*")) if p.is_file())
        found = [Member(p) for p in inside if _is_data(p.relative_to(path).as_posix())]
    elif not path.is_file():
        raise InputError(f"{path}: no such file or folder; give a recording")
    elif _begins_as_zip(path):
        with guarded_reading(path, "zip file", FIX), zipfile.ZipFile(path) as archive:
            names = [info.filename for info in archive.infolist() if not info.is_dir()]
        found = [Member(path, name) for name in sorted(names) if _is_data(name)]
    else:
        found = [Member(path)]
    if not found or len(found) > MOST_FILES:
        raise InputError(f"{path}: got {len(found)} files of data in it, wanted 1 to {MOST_FILES}; give a recording")
    return found


def sha256(path: Path) -> str:
    """Hash of a file's content, or of the contents and names of all files of a folder."""
    if path.is_file():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    whole = hashlib.sha256()
    for member in members(path):
        whole.update(f"{member.path.relative_to(path).as_posix()} {sha256(member.path)}\n".encode())
    return whole.hexdigest()
