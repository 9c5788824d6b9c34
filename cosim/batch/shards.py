"""Shards of a batch: the tables of many finished runs in one file each, instead of a folder per run.

    shards/<shard>.json            the runs in it, the starts of each, and the hashes of its tables (sealed)
    groups/<shard>.parquet         their rows, with a column `run`; counterparts/ etc. likewise

A shard never changes. It counts from the moment its JSON file is there; files of tables without one are removed. The
same runs give the same name and the same bytes, whenever they finished.
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from cosim.batch.spec import Kept, MoreTables, Shards
from cosim.runs.finished_run import read_manifest
from gri.errors import InputError, guarded_reading
from gri.storage.verification import DamagedError, check_digest, digest, read_sealed, set_aside, write_sealed
from gri.storage.whole_files import remove, sweep, whole_file

FOLDER = "shards"
FIX = "run `cosim batch` again, which repairs it"
ALWAYS_KEPT: dict[str, Kept] = {"groups": "all", "counterparts": "all", "traffic": "all"}  # for results and reports
NAME = "s" + 11 * "[0-9a-f]"  # pattern of the names of shards
ROWS = 200_000  # of a row group at least, so that packing needs little memory


class PackedRun(msgspec.Struct, frozen=True):
    """A run in a shard: its id, how many starts it found, and how many it was asked for."""

    run: str
    starts: int
    asked: int


class Shard(msgspec.Struct, frozen=True):
    """What the JSON file of a shard says: its runs, and the hash of each of its tables."""

    runs: tuple[PackedRun, ...]
    tables: dict[str, str]


def is_sharded(batch: Path) -> bool:
    """Whether finished runs of a batch go, or once went, into shards."""
    return (batch / FOLDER).is_dir()


def shard_name(runs: Iterable[str]) -> str:
    """The name of the shard of these runs."""
    return f"s{hashlib.sha256(' '.join(runs).encode()).hexdigest()[:11]}"


def table_file(batch: Path, table: str, shard: str) -> Path:
    """Where a shard has a table."""
    return batch / table / f"{shard}.parquet"


def read_shards(batch: Path) -> dict[str, Shard]:
    """All shards of a batch by name. Errors: `DamagedError`, `InputError`."""
    return {path.stem: _read(path) for path in _index_files(batch)}


def open_shards(batch: Path, warn: Callable[[str], None]) -> None:
    """Prepare a batch that has shards for writing. Only for the claimant of its folder.

    Damaged shards are moved to `damaged/`, and `warn` is called with a sentence about each. What an interrupted
    command left is removed: files of tables without a shard, and folders of runs that are in one.
    """
    (batch / FOLDER).mkdir(exist_ok=True)
    sweep(batch / FOLDER)
    sound = {}
    for path in _index_files(batch):
        try:
            sound[path.stem] = shard = _read(path)
            for table, wanted in shard.tables.items():
                check_digest(table_file(batch, table, path.stem), wanted, FIX)
        except InputError as error:
            sound.pop(path.stem, None)
            aside = _set_shard_aside(batch, path.stem)
            warn(f"{str(error).partition(';')[0]}; its runs are done again, its files are in {aside}")
    for table in (*ALWAYS_KEPT, *MoreTables.__struct_fields__):
        sweep(batch / table)
        for file in (batch / table).glob(f"{NAME}.parquet"):
            if file.stem not in sound:
                remove(file)
    for shard in sound.values():
        for run in shard.runs:
            remove(batch / "runs" / run.run)


def check_kept(shards: Shards, run: Path) -> None:
    """Raise `InputError` if a finished run lacks a table or a column that the shards are to keep."""
    for table, columns in shards.tables.kept().items():
        path = run / f"{table}.parquet"
        if not path.is_file():
            more = "; `overrides: {surroundings: true}` makes runs write it" if table == "surroundings" else ""
            raise InputError(f"shards: tables: {table}: the runs have no such table; leave it out{more}")
        known = pq.read_schema(path).names
        if missing := [name for name in columns if name not in known] if columns != "all" else []:
            raise InputError(
                f"shards: tables: {table}: no column {missing[0]!r}; expected some of {', '.join(known)}, or `all`"
            )


def pack(batch: Path, shards: Shards, runs: Mapping[str, int]) -> None:
    """Write the shard of these finished runs, given by id with the number of starts that they were asked for.

    Their folders are removed once the shard is on the disk. An OSError leaves them as they were.
    """
    name = shard_name(runs)
    folders = {run: batch / "runs" / run for run in runs}
    manifests = {run: read_manifest(folder) for run, folder in folders.items()}
    hashes = {}
    for table, columns in (ALWAYS_KEPT | shards.tables.kept()).items():
        file = f"{table}.parquet"
        parts = {
            run: check_digest(folders[run] / file, manifest["results"][file], FIX)
            for run, manifest in manifests.items()
            if file in manifest["results"]
        }
        if parts:
            path = table_file(batch, table, name)
            _write(path, parts, columns)
            hashes[table] = digest(path)
    packed = (PackedRun(run, starts_of(manifests[run], asked), asked) for run, asked in runs.items())
    write_sealed(batch / FOLDER / f"{name}.json", msgspec.to_builtins(Shard(tuple(packed), hashes)))
    for folder in folders.values():
        remove(folder)


def starts_of(manifest: Mapping[str, Any], asked: int) -> int:
    """How many starts a run found, by its manifest."""
    return manifest.get("arguments", {}).get("starts", asked)


def table_of_run(path: Path, run: str, columns: Kept = "all", *, rows: bool = True) -> pa.Table:
    """A table of one run with the column `run`; without `rows` just its columns."""
    with guarded_reading(path, "table of a run", FIX):
        table = pq.read_table(path) if rows else pq.read_schema(path).empty_table()
        table = table.replace_schema_metadata(None)
        table = table if columns == "all" else table.select(list(columns))
    return table.append_column("run", pa.array([run] * len(table), pa.string()))


def read_packed(batch: Path, table: str, shards: Mapping[str, Shard], runs: Sequence[str]) -> Iterator[pa.Table]:
    """The rows of a table that shards hold of these runs. Errors: `DamagedError` where they have been changed."""
    for name, shard in shards.items():
        wanted = {run.run for run in shard.runs} & set(runs)
        if wanted and table in shard.tables:
            path = check_digest(table_file(batch, table, name), shard.tables[table], FIX)
            with guarded_reading(path, "table of a batch", FIX):
                some = None if len(wanted) == len(shard.runs) else [("run", "in", wanted)]
                yield pq.read_table(path, filters=some)


def _index_files(batch: Path) -> list[Path]:
    return sorted((batch / FOLDER).glob("*.json"))


def _read(path: Path) -> Shard:
    content = read_sealed(path, FIX)
    try:
        return msgspec.convert(content, Shard)
    except msgspec.ValidationError as error:
        raise DamagedError(f"{path}: {error}; {FIX}") from None


def _set_shard_aside(batch: Path, name: str) -> Path:
    aside = batch / "damaged" / name
    if aside.exists():
        set_aside(aside)
    aside.mkdir(parents=True)
    for file in batch.glob(f"*/{name}.parquet"):
        file.rename(aside / f"{file.parent.name}.parquet")
    (batch / FOLDER / f"{name}.json").rename(aside / "shard.json")
    return aside


def _write(path: Path, parts: Mapping[str, Path], columns: Kept) -> None:
    """Write the rows of the runs one after the other, with the columns that any of them has.

    Tables without rows have no say in this, as their columns have no types.
    """
    filled = {run: part for run, part in parts.items() if pq.read_metadata(part).num_rows}
    parts = filled or dict(list(parts.items())[:1])
    schemas = (table_of_run(part, run, columns, rows=False).schema for run, part in parts.items())
    schema = pa.unify_schemas(list(dict.fromkeys(schemas)), promote_options="permissive")
    with whole_file(path) as target, pq.ParquetWriter(target, schema, compression="zstd") as writer:
        waiting: list[pa.Table] = []
        for k, (run, part) in enumerate(parts.items(), 1):
            waiting.append(table_of_run(part, run, columns))
            if k == len(parts) or sum(map(len, waiting)) >= ROWS:
                joined = pa.concat_tables([schema.empty_table(), *waiting], promote_options="permissive")
                writer.write_table(joined.cast(schema))
                waiting = []
