"""Run and batch folders as inputs: one archive of a folder, mutations of a file in it, and readers of the folder.

A mutated file has another hash, so most of these inputs are refused for that. *Resealed* ones have right hashes again,
as after a mistake of a program: what is in them must be noticed by its type, its columns and its shape.
"""

import io
import json
import os
import random
import tempfile
import zipfile
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import msgspec

from cosim.batch.result_listing import failures_table, groups_of, runs_table
from cosim.batch.spec import Shards
from cosim.batch.store import BatchStore
from cosim.runs.finished_run import read_scenario
from cosim.runs.run_results import open_run
from gri.errors import InputError
from gri.storage.verification import SEAL, sealed
from tests.cosim.runs.finished import finished_run

Mutate = Callable[[random.Random, bytes], bytes]
LABELS = {"scenario": "us101", "policy": "idm", "perturbation": "nominal", "intensity": None, "variant": "plain"}


def pack(folder: Path, unread: tuple[str, ...] = ()) -> bytes:
    """The files of a folder as one archive, without those whose path has one of the words `unread` in it."""
    paths = {str(path.relative_to(folder)): path for path in folder.rglob("*") if path.is_file()}
    chosen = {name: path for name, path in paths.items() if not any(word in name for word in unread)}
    return packed_files({name: path.read_bytes() for name, path in chosen.items()})


def files_of(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def packed_files(files: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in sorted(files.items()):
            archive.writestr(zipfile.ZipInfo(name), content)
    return out.getvalue()


def inside(of_bytes: tuple[Mutate, ...], of_tables: Mutate) -> tuple[Mutate, ...]:
    """Mutations of a folder, made of those of bytes and of tables."""

    def changed(rng: random.Random, content: bytes) -> dict[str, bytes]:
        files = files_of(content)
        name = rng.choice(sorted(files))
        kinds: list[Callable[[], bytes | None]] = [
            lambda: rng.choice(of_bytes)(rng, files[name]),
            lambda: rng.choice(sorted(files.values())),  # that of another file
            lambda: b"",
            lambda: None,
        ]
        if name.endswith(".parquet"):
            kinds += [lambda: of_tables(rng, files[name])] * 4
        if name.endswith(".json"):
            kinds += [lambda: _spoilt(rng, files[name])] * 4
        found = rng.choice(kinds)()
        return {key: value for key, value in {**files, name: found}.items() if value is not None}

    def damaged(rng: random.Random, content: bytes) -> bytes:
        return packed_files(changed(rng, content))

    def resealed(rng: random.Random, content: bytes) -> bytes:
        return packed_files(_resealed(changed(rng, content)))

    return damaged, resealed


def _spoilt(rng: random.Random, text: bytes) -> bytes:
    """Remove or replace a value in a JSON file."""
    tree = json.loads(text)
    parent = tree
    while True:
        key = rng.choice(sorted(parent)) if isinstance(parent, dict) else rng.randrange(len(parent))
        if not isinstance(parent[key], dict | list) or not parent[key] or rng.random() < 0.3:
            break
        parent = parent[key]
    if isinstance(parent, dict) and rng.random() < 0.3:
        del parent[key]
    else:
        parent[key] = rng.choice((None, -1, 2**70, "x", "", [], {}, [None], {"a": 1}, "\0", True))
    return json.dumps(tree).encode()


def _resealed(files: dict[str, bytes]) -> dict[str, bytes]:
    """The files with right hashes in every manifest that can be read."""
    done = dict(files)
    for name, content in files.items():
        try:
            tree = msgspec.json.decode(content) if name.endswith(".json") else None
        except msgspec.MsgspecError:
            continue
        if not isinstance(tree, dict) or SEAL not in tree:
            continue
        folder = os.path.dirname(name)
        results, shard = tree.get("results"), tree.get("tables")
        for file in results if isinstance(results, dict) else ():
            path = os.path.join(folder, file)
            if isinstance(file, str) and path in files:
                tree["results"][file] = sha256(files[path]).hexdigest()
        for table in shard if isinstance(shard, dict) else ():
            path = f"{table}/{os.path.basename(name).removesuffix('.json')}.parquet"
            if path in files:
                tree["tables"][table] = sha256(files[path]).hexdigest()
        done[name] = json.dumps(sealed(tree)).encode()
    for name in files:  # the tables of a batch are those of its runs
        parts = name.split("/")
        if len(parts) == 3 and parts[2] == "part.parquet":
            own = f"runs/{parts[1].removeprefix('run=')}/{parts[0]}.parquet"
            done[name] = done.get(own, done[name])
    return done


@cache
def good_run() -> tuple[bytes, ...]:
    with tempfile.TemporaryDirectory() as scratch:
        return (pack(finished_run(Path(scratch, "run"))),)


@cache
def good_batch() -> tuple[bytes, ...]:
    """A batch with a folder per run, and the same in a shard."""
    return _good_batch(None), _good_batch(Shards())


def _good_batch(shards: Shards | None) -> bytes:
    with tempfile.TemporaryDirectory() as scratch:
        store = BatchStore(Path(scratch, "batch"))
        with store.opened({"ra"}, print, sharded=shards is not None):
            store.finish("ra", finished_run(store.attempt_folder("ra", 0), labels={**LABELS, "seed": 1}))
            if shards:
                store.pack(shards, {"ra": 1})
            store.fail("rb", {"run": "rb", "labels": LABELS, "attempts": [{"kind": "died", "message": "SIGKILL"}]})
            runs = [
                {"run": run, "key": run, **LABELS, "seed": seed, "state": state}
                for run, seed, state in (("ra", 1, "done"), ("rb", 2, "failed"))
            ]
            store.write_manifest({"file": "a.yaml", "batch": {}, "states": {"done": 1, "failed": 1}, "runs": runs})
        return pack(store.folder, ("steps", "events", "graphs", "surroundings", "scenario"))


def read_run(path: Path) -> Any:
    """Everything that readers of a run take from it."""
    return _unpacked(path, _run_content)


def _run_content(folder: Path) -> None:
    run = open_run(folder)
    assert run.surroundings is not None
    run.warnings(), run.policy_failures, run.effects, repr(run), read_scenario(folder)


def read_batch(path: Path) -> Any:
    """Everything that readers of a batch take from it before they compute anything."""
    return _unpacked(path, _batch_content)


def _batch_content(folder: Path) -> None:
    store = BatchStore(folder)
    runs_table(store, []), failures_table(store), groups_of(store)


def _unpacked(path: Path, read: Callable[[Path], None]) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        try:
            with zipfile.ZipFile(path) as archive:
                archive.extractall(scratch)
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError, RuntimeError):
            raise InputError(f"{path}: the archive itself is broken, so there is no folder to read") from None
        read(Path(scratch))
