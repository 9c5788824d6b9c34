"""Run folders: a folder appears whole or not at all, because it is written beside its place and then moved there."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gri.errors import InputError
from gri.storage.claims import claimed_place, is_claimed
from gri.storage.whole_files import part_beside, publish, remove


@contextmanager
def run_folder(wanted: Path) -> Iterator[Path]:
    """A folder to write a run into; it moves to `wanted` on success and is removed otherwise.

    Until then `wanted` belongs to this process. Errors: `InputError` if it exists, cannot be written, or another
    command writes there.
    """
    with claimed_place(wanted):
        if wanted.exists():
            raise InputError(f"{wanted} exists already; give another --out or remove it")
        part = part_beside(wanted)
        try:
            part.mkdir()
        except OSError as error:
            raise InputError(f"cannot write to {wanted}: {error.strerror}; give another --out") from None
        try:
            yield part
            publish(part, wanted)
        finally:
            remove(part)


def next_folder(parent: Path, name: str) -> Path:
    """`parent/name`, or with the first number behind it that is free: neither there nor being written."""
    candidates = (parent / (name if k == 1 else f"{name}-{k}") for k in range(1, 10**6))
    return next(path for path in candidates if not path.exists() and not is_claimed(path))
