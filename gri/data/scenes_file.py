"""The project's scene file: one Parquet table for scenes of any origin (docs/scenes.md).

One row per scene, vehicle and step, in that order, so that `pandas.read_parquet` gives a table to work with and whole
scenes lie together. Scenes are written group by group; memory holds one group, not the file. The same scenes and
provenance give the same bytes.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri.dynamics import Dynamics
from gri.errors import InputError
from gri.graph import EdgeType, Vocabulary, pairs
from gri.types import Trajectory

FORMAT, VERSION = "gri-scenes", 1
KEY = b"gri.scenes"
FEATURES = ("x", "y", "vx", "vy", "ax", "ay", "v", "a", "heading", "yaw_rate")
"""State columns, SI units: together they hold the states of all dynamics. What a source does not know is null."""
ROWS = 300_000  # a row group at most


@dataclass(frozen=True)
class SceneBlock:
    """S scenes of N vehicles over T steps that share their kind; the last vehicle is the given leader."""

    kind: str
    """`car_following`, `lane_changing`, or another word the source defines."""
    source: np.ndarray
    """[S] Where each scene is from: a site, a scenario."""
    recording: np.ndarray
    """[S] Which recording or episode of the source; vehicle numbers mean something within it."""
    split: np.ndarray
    """[S] `train`, `validation` or `test`."""
    start: np.ndarray
    """[S] Time of step 0 since the recording began [s]."""
    vehicle: np.ndarray
    """[S, N] Numbers of the vehicles."""
    features: Mapping[str, np.ndarray]
    """[S, N, T] of some of `FEATURES`."""
    edges: np.ndarray
    """[S, E] Names of edge types over ordered pairs (`gri.graph.pairs`): the truth, or what is taken for it."""
    valid: np.ndarray | None = None
    """[S, N, T] Which states exist; None: all."""
    size: Mapping[str, np.ndarray] = field(default_factory=dict)
    """[S, N] `length` and `width` [m], 0 where unknown."""
    step_edges: np.ndarray | None = None
    """[S, E, T] Edge types step by step, where they change; None: they do not."""

    @property
    def shape(self) -> tuple[int, int, int]:
        return next(iter(self.features.values())).shape

    def __getitem__(self, scenes: slice) -> "SceneBlock":
        def cut(values: Any) -> Any:
            if isinstance(values, Mapping):
                return {name: array[scenes] for name, array in values.items()}
            return values[scenes] if isinstance(values, np.ndarray) else values

        return SceneBlock(**{f.name: cut(getattr(self, f.name)) for f in fields(self)})


class Header(msgspec.Struct, frozen=True, kw_only=True):
    """What the file says of itself, as JSON under `gri.scenes` in the Parquet metadata."""

    dt: float
    """Time between two steps [s]."""
    vehicles: int = 3
    """N."""
    format: str = FORMAT
    version: int = VERSION
    provenance: dict[str, Any] = {}
    """What made the scenes: files with their hashes, options, counts, versions. Nothing that changes by itself."""


@dataclass(frozen=True)
class Recorded:
    """Scenes read back for a model."""

    trajectory: Trajectory
    graph: Int[Tensor, "S E"]
    """Edge types as indices into the vocabulary asked for."""
    source: np.ndarray
    split: np.ndarray
    vehicle: np.ndarray
    length: Float[Tensor, "S N"]

    def __len__(self) -> int:
        return len(self.graph)


def schema(header: Header) -> pa.Schema:
    """The columns; see docs/scenes.md."""
    word = pa.dictionary(pa.int32(), pa.string())
    edges = [f"{name}_{i}" for name in ("edge_from", "step_edge_from") for i in range(header.vehicles)]
    columns = [("scene", pa.int64()), *((name, word) for name in ("kind", "source", "recording", "split"))]
    columns += [("role", pa.int8()), ("vehicle", pa.int64()), ("step", pa.int16()), ("time", pa.float64())]
    columns += [("valid", pa.bool_()), *((name, pa.float32()) for name in (*FEATURES, "length", "width"))]
    columns += [(name, word) for name in edges]
    return pa.schema(columns, metadata={KEY: msgspec.json.encode(header, order="sorted")})


@contextmanager
def writing(path: Path, header: Header) -> Iterator[Callable[[SceneBlock], None]]:
    """A function that appends scenes; the file appears whole at the end or not at all, scenes numbered as they come."""
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


def _table(block: SceneBlock, first: int, header: Header) -> pa.Table:
    count, n, steps = block.shape
    scene = np.arange(first, first + count)

    def spread(values: np.ndarray) -> np.ndarray:
        """[S] or [S, N] values on every row."""
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
    if block.step_edges is not None:
        columns |= _edge_columns("step_edge_from", block.step_edges, n)
    layout = schema(header)
    empty = pa.nulls(count * n * steps)
    arrays = [pa.array(columns[f.name]) if f.name in columns else empty for f in layout]
    return pa.Table.from_arrays([a.cast(f.type) for a, f in zip(arrays, layout, strict=True)], schema=layout)


def _edge_columns(name: str, edges: np.ndarray, n: int) -> dict[str, np.ndarray]:
    """Column i holds, on the rows of vehicle j, the type of i → j; null for i = j."""
    table = np.full((len(edges), n, n, edges.shape[2]), None, object)
    for e, (i, j) in enumerate(pairs(n)):
        table[:, i, j] = edges[:, e]
    return {f"{name}_{i}": table[:, i].ravel() for i in range(n)}


def header_of(path: Path) -> Header:
    """What the file says of itself. Errors: `InputError` where it is no scene file."""
    return _header(_opened(path), path)


def read(path: Path, kind: str, dynamics: Dynamics, vocabulary: Vocabulary, split: str | None = None) -> Recorded:
    """All scenes of a kind (and split), as states of the given dynamics.

    Errors: `InputError` where the file is no scene file, has no such scenes, or lacks a state feature or edge type.
    """
    header = _header(_opened(path), path)
    n = header.vehicles
    filters = [("kind", "=", kind)] + ([("split", "=", split)] if split else [])
    names = ["scene", "step", "valid", "source", "split", "vehicle", "length", *dynamics.state]
    table = pq.read_table(path, columns=[*names, *[f"edge_from_{i}" for i in range(n)]], filters=filters)
    if not table.num_rows:
        raise InputError(f"{path}: has no scenes of kind {kind}{f' in split {split}' if split else ''}; make some")
    steps = int(table["step"].to_numpy().max()) + 1
    if table.num_rows % (n * steps) or np.any(np.diff(table["scene"].to_numpy()[:: n * steps]) <= 0):
        raise InputError(f"{path}: scenes of kind {kind} differ in length; write each length to a file of its own")
    shape = (-1, n, steps)
    for name in dynamics.state:
        if table[name].null_count:
            raise InputError(f"{path}: column {name} is not filled in for kind {kind}, wanted by {dynamics.name}")
    state = np.stack([table[name].to_numpy().reshape(shape) for name in dynamics.state], -1)
    valid = table["valid"].to_numpy(zero_copy_only=False).reshape(shape)
    first = {name: table[name].to_numpy(zero_copy_only=False).reshape(shape)[:, :, 0] for name in names[3:7]}
    edges = [table[f"edge_from_{i}"].to_numpy(zero_copy_only=False).reshape(shape)[:, j, 0] for i, j in pairs(n)]
    return Recorded(
        Trajectory(torch.from_numpy(state).float(), torch.from_numpy(valid.copy()), header.dt),
        torch.from_numpy(_indices(np.stack(edges, 1), vocabulary, path)),
        first["source"][:, 0],
        first["split"][:, 0],
        first["vehicle"],
        torch.from_numpy(np.nan_to_num(first["length"].astype(np.float32))),
    )


def scene_counts(path: Path) -> set[tuple[str, str]]:
    """The (kind, split) pairs that a file has scenes of. Errors: `InputError` where it is no scene file."""
    _header(_opened(path), path)
    table = pq.read_table(path, columns=["kind", "split"]).unify_dictionaries()
    found = table.group_by(["kind", "split"]).aggregate([])
    return set(zip(found["kind"].to_pylist(), found["split"].to_pylist(), strict=True))


def joined(parts: Sequence[Recorded]) -> Recorded:
    """Scenes of the same shape one after the other."""
    first = parts[0].trajectory
    state, valid = (torch.cat([getattr(p.trajectory, name) for p in parts]) for name in ("state", "valid"))
    return Recorded(
        Trajectory(state, valid, first.dt),
        torch.cat([part.graph for part in parts]),
        np.concatenate([part.source for part in parts]),
        np.concatenate([part.split for part in parts]),
        np.concatenate([part.vehicle for part in parts]),
        torch.cat([part.length for part in parts]),
    )


def _indices(names: np.ndarray, vocabulary: Vocabulary, path: Path) -> np.ndarray:
    unknown = set(names.ravel().tolist()) - {str(kind) for kind in vocabulary}
    if unknown:
        wanted = ", ".join(vocabulary)
        raise InputError(f"{path}: got edge type {sorted(map(str, unknown))[0]}, wanted one of {wanted}")
    index = {str(kind): k for k, kind in enumerate(vocabulary)}
    return np.vectorize(index.__getitem__, otypes=[np.int64])(names)


def names_of(edges: Mapping[tuple[int, int], EdgeType], n: int = 3) -> np.ndarray:
    """[E] Names of the types of one graph, "none" where it has no edge."""
    return np.array([str(edges.get(pair, EdgeType.NONE)) for pair in pairs(n)], object)


def _opened(path: Path) -> pq.ParquetFile:
    try:
        return pq.ParquetFile(path)
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path}: not a readable scene file ({str(error).splitlines()[0]}); make it again") from error


def _header(file: pq.ParquetFile, path: Path) -> Header:
    text = (file.schema_arrow.metadata or {}).get(KEY)
    if text is None:
        raise InputError(f"{path}: a Parquet file, but not a scene file; give one written by `gri ngsim scenes`")
    header = msgspec.json.decode(text, type=Header)
    if (header.format, header.version) != (FORMAT, VERSION):
        raise InputError(f"{path}: got {header.format} {header.version}, this release reads {FORMAT} {VERSION}")
    return header
