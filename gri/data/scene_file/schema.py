"""The project's scene file: one Parquet table for scenes of every origin (docs/scenes.md).

The table has one row per scene, vehicle and step, in that order. So `pandas.read_parquet` gives a usable table, and the
rows of a scene are together. Scenes are written in row groups; memory holds one group, not the whole file. The same
scenes and provenance give the same bytes.
"""

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from gri.core.edges import EdgeType, pairs
from gri.errors import InputError, guarded_reading
from gri.storage.verification import check_own_digest

FORMAT, VERSION = "gri-scenes", 1
KEY = b"gri.scenes"
REMAKE = "make it again with `cosim scenes` or `gri ngsim scenes`"
FEATURES = ("x", "y", "vx", "vy", "ax", "ay", "v", "a", "heading", "yaw_rate")
"""State columns in SI units, for all dynamics together. Columns that a source does not have are null."""
ROWS = 300_000
"""Rows of one row group at most."""
MOST_ROWS, ROWS_PER_BYTE = 100_000_000, 10
"""Rows of a file at most: a row has some twenty columns, of which numbers such as x cannot be compressed away."""


@dataclass(frozen=True)
class SceneBlock:
    """S scenes of one kind, with N vehicles and T steps each. The last vehicle is the leader."""

    kind: str
    """`car_following`, `lane_changing_h1`, or another word that the source defines."""
    source: np.ndarray
    """[S] Site or scenario of each scene."""
    recording: np.ndarray
    """[S] Recording or episode of the source. Vehicle numbers are unique within it."""
    split: np.ndarray
    """[S] `train`, `validation` or `test`."""
    start: np.ndarray
    """[S] Time of step 0, from the start of the recording [s]."""
    vehicle: np.ndarray
    """[S, N] Numbers of the vehicles."""
    features: Mapping[str, np.ndarray]
    """[S, N, T] for some of `FEATURES`, SI units."""
    edges: np.ndarray
    """[S, E] Names of the edge types, in the order of `gri.core.graph.pairs`: true or hypothesised."""
    valid: np.ndarray | None = None
    """[S, N, T] Whether each state exists; None: all exist."""
    size: Mapping[str, np.ndarray] = field(default_factory=dict)
    """[S, N] for `length` and `width` [m]; 0 if unknown."""
    step_edges: np.ndarray | None = None
    """[S, E, T] Edge types at each step; None if they are constant."""
    rule_edges: np.ndarray | None = None
    """[S, E, T] Edge types at each step by simpler rules; None if the source does not have them."""
    effect: np.ndarray | None = None
    """[S, E, T] Effect of the edge on the receiver's acceleration at each step [m/s²]; negative: it slows down."""
    hypothesis: np.ndarray | None = None
    """[S, E] Edge types that the geometry suggests; None if `edges` come from the geometry themselves."""
    unambiguous: np.ndarray | None = None
    """[S] Whether `edges` contains all relations of `step_edges`."""
    vehicle_type: np.ndarray | None = None
    """[S, N] Type of each vehicle, in the source's words."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """(S, N, T)."""
        return next(iter(self.features.values())).shape

    def __getitem__(self, scenes: slice) -> "SceneBlock":
        """The selected scenes."""

        def cut(values: Any) -> Any:
            if isinstance(values, Mapping):
                return {name: array[scenes] for name, array in values.items()}
            return values[scenes] if isinstance(values, np.ndarray) else values

        return SceneBlock(**{f.name: cut(getattr(self, f.name)) for f in fields(self)})


class Header(msgspec.Struct, frozen=True, kw_only=True):
    """The file's metadata: JSON under the key `gri.scenes` of the Parquet metadata."""

    dt: float
    """Time between two steps [s]."""
    vehicles: int = 3
    """N, the same for all scenes of the file."""
    format: str = FORMAT
    version: int = VERSION
    provenance: dict[str, Any] = {}
    """How the scenes were made: files with their hashes, options, counts, versions. No dates: bytes stay the same."""


def schema(header: Header) -> pa.Schema:
    """The columns of a file (docs/scenes.md)."""
    word = pa.dictionary(pa.int32(), pa.string())
    kinds = "edge_from", "step_edge_from", "rule_edge_from", "hypothesis_from"
    edges = [f"{name}_{i}" for name in kinds for i in range(header.vehicles)]
    columns = [("scene", pa.int64()), *((name, word) for name in ("kind", "source", "recording", "split"))]
    columns += [("role", pa.int8()), ("vehicle", pa.int64()), ("step", pa.int16()), ("time", pa.float64())]
    columns += [("valid", pa.bool_()), *((name, pa.float32()) for name in (*FEATURES, "length", "width"))]
    columns += [(name, word) for name in edges]
    columns += [(f"effect_from_{i}", pa.float32()) for i in range(header.vehicles)]
    columns += [("unambiguous", pa.bool_()), ("vehicle_type", word)]
    return pa.schema(columns, metadata={KEY: msgspec.json.encode(header, order="sorted")})


@contextmanager
def writing(path: Path, header: Header) -> Iterator[Callable[[SceneBlock], None]]:
    """Open a new scene file and yield the function that appends blocks of scenes.

    Scenes are numbered in the order in which they are appended. The file is complete or it does not exist: a temporary
    file is renamed at the end.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.part")
    written = 0
    try:
        with pq.ParquetWriter(part, schema(header), compression="zstd") as writer:

            def write(block: SceneBlock) -> None:
                nonlocal written
                count, vehicles, steps = block.shape
                assert vehicles == header.vehicles, f"got {vehicles} vehicles, the file has {header.vehicles}"
                size = max(1, ROWS // (vehicles * steps))
                for start in range(0, count, size):
                    writer.write_table(_table(block[start : start + size], written + start, header))
                written += count

            yield write
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def joining(path: Path, header: Header) -> Iterator[Callable[[Path, Mapping[str, int]], None]]:
    """Open a new scene file and yield the function that appends scenes of existing files; else like `writing`.

    The function takes the path of a file and the number of scenes of each kind; it appends the first so many, with new
    scene numbers. Memory holds one row group.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.part")
    written = 0
    try:
        with pq.ParquetWriter(part, schema(header), compression="zstd") as writer:

            def append(source: Path, wanted: Mapping[str, int]) -> None:
                nonlocal written
                left, file = dict(wanted), opened(source)
                for group in range(file.num_row_groups):
                    table = file.read_row_group(group)
                    kind, numbers = table["kind"][0].as_py(), table["scene"].to_numpy()
                    taken = np.unique(numbers)[: left.get(kind, 0)]
                    left[kind] = left.get(kind, 0) - len(taken)
                    table = table.filter(pa.array(np.isin(numbers, taken)))
                    place = table.schema.get_field_index("scene")
                    new = written + np.searchsorted(taken, table["scene"].to_numpy())
                    if len(taken):
                        writer.write_table(table.set_column(place, "scene", pa.array(new)).cast(schema(header)))
                    written += len(taken)

            yield append
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def _table(block: SceneBlock, first: int, header: Header) -> pa.Table:
    count, n, steps = block.shape
    scene = np.arange(first, first + count)

    def spread(values: np.ndarray) -> np.ndarray:
        """Values [S] or [S, N] repeated for every row."""
        shaped = values.reshape(*values.shape, *[1] * (3 - values.ndim))
        return np.broadcast_to(shaped, (count, n, steps)).ravel()

    step = np.broadcast_to(np.arange(steps), (count, n, steps))
    columns: dict[str, Any] = {
        "scene": spread(scene),
        "kind": np.full(count * n * steps, block.kind, object),
        "source": spread(block.source.astype(object)),
        "recording": spread(block.recording.astype(object)),
        "split": spread(block.split.astype(object)),
        "role": spread(np.broadcast_to(np.arange(n), (count, n))),
        "vehicle": spread(block.vehicle),
        "step": step.ravel(),
        "time": (block.start[:, None, None] + step * header.dt).ravel().round(6),
        "valid": np.ones(count * n * steps, bool) if block.valid is None else block.valid.ravel(),
    }
    columns |= {name: values.ravel() for name, values in block.features.items()}
    columns |= {name: spread(values) for name, values in block.size.items()}
    columns |= _edge_columns("edge_from", np.repeat(block.edges[:, :, None], steps, 2), n)
    if block.hypothesis is not None:
        columns |= _edge_columns("hypothesis_from", np.repeat(block.hypothesis[:, :, None], steps, 2), n)
    changing = {"step_edge_from": block.step_edges, "rule_edge_from": block.rule_edges, "effect_from": block.effect}
    for name, values in changing.items():
        columns |= {} if values is None else _edge_columns(name, values, n)
    rest = {"unambiguous": block.unambiguous, "vehicle_type": block.vehicle_type}
    columns |= {name: spread(values) for name, values in rest.items() if values is not None}
    layout = schema(header)
    arrays = [_column(columns.get(f.name), f.type, count * n * steps) for f in layout]
    return pa.Table.from_arrays(arrays, schema=layout)


def _column(values: np.ndarray | None, kind: pa.DataType, rows: int) -> pa.Array:
    """A column of the file's type; all null if `values` is None. Words become codes in order of appearance."""
    if values is None:
        return pa.nulls(rows, kind)
    if not pa.types.is_dictionary(kind):
        return pa.array(values).cast(kind)
    codes, words = pd.factorize(values)
    return pa.DictionaryArray.from_arrays(pa.array(codes, pa.int32(), mask=codes < 0), pa.array(words, pa.string()))


def _edge_columns(name: str, edges: np.ndarray, n: int) -> dict[str, np.ndarray]:
    """N columns. In the rows of vehicle j, column i contains the value of the edge i → j; null for i = j."""
    table = np.full((len(edges), n, n, edges.shape[2]), None, object)
    for e, (i, j) in enumerate(pairs(n)):
        table[:, i, j] = edges[:, e]
    return {f"{name}_{i}": table[:, i].ravel() for i in range(n)}


def header_of(path: Path) -> Header:
    """The header of a scene file. Errors: `InputError` if it is not a scene file."""
    return read_header(opened(path), path)


def names_of(edges: Mapping[tuple[int, int], EdgeType], n: int = 3) -> np.ndarray:
    """[E] Names of the edge types of one graph; pairs that `edges` does not contain have "none"."""
    return np.array([str(edges.get(pair, EdgeType.NONE)) for pair in pairs(n)], object)


def opened(path: Path) -> pq.ParquetFile:
    """An opened Parquet file. Errors: `InputError` if it is not readable as Parquet, or has not the hash beside it."""
    with guarded_reading(path, "scene file", REMAKE):
        file = pq.ParquetFile(check_own_digest(path, REMAKE))
        rows, size = file.metadata.num_rows, path.stat().st_size
        if rows > MOST_ROWS or rows > ROWS_PER_BYTE * size + ROWS:
            raise InputError(f"{path}: claims {rows:,} rows in {size:,} bytes; make the file again, or split it")
        return file


def read_header(file: pq.ParquetFile, path: Path) -> Header:
    """The header of an opened file. Errors: `InputError` if it is not a scene file, or of another version."""
    text = (file.schema_arrow.metadata or {}).get(KEY)
    if text is None:
        raise InputError(
            f"{path}: a Parquet file, but not a scene file; give one of `gri ngsim scenes` or `cosim scenes`"
        )
    with guarded_reading(path, "scene file", REMAKE):
        header = msgspec.json.decode(text, type=Header)
    if (header.format, header.version) != (FORMAT, VERSION):
        raise InputError(
            f"{path}: got {header.format} {header.version}, this release reads {FORMAT} {VERSION}; make the file again"
        )
    if not 0.01 <= header.dt <= 10 or not 1 <= header.vehicles <= 1000:
        raise InputError(
            f"{path}: got a step of {header.dt} s and {header.vehicles} vehicles, expected 0.01 to 10 s and 1 to 1000"
            " vehicles; make the file again"
        )
    return header
