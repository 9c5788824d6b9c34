"""Run folders: a folder appears whole or not at all, because it is written beside its place and then moved there."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gri.errors import InputError


@contextmanager
def run_folder(wanted: Path) -> Iterator[Path]:
    """A folder to write a run into; it moves to `wanted` on success and is removed otherwise."""
    if wanted.exists():
        raise InputError(f"{wanted} exists already; give another --out or remove it")
    partial = wanted.with_name(wanted.name + ".partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"cannot write to {wanted}: {error.strerror}; give another --out") from None
    try:
        yield partial
        os.replace(partial, wanted)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


def next_folder(parent: Path, name: str) -> Path:
    """`parent/name`, or with the first number behind it that is free."""
    candidates = (parent / (name if k == 1 else f"{name}-{k}") for k in range(1, 10**6))
    return next(path for path in candidates if not path.exists())
