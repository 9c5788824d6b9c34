"""Reading scene files (`gri.data.scene_file.schema`) as tensors for models."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gri.core.dynamics import Dynamics
from gri.core.graph import Vocabulary, pairs
from gri.core.trajectory import Trajectory
from gri.data.scene_file.schema import opened, read_header
from gri.errors import InputError, guarded_reading


@dataclass(frozen=True)
class Recorded:
    """S scenes of a scene file, as a model needs them."""

    trajectory: Trajectory
    """States [S, N, T, D]."""
    graph: Int[Tensor, "S E"]
    """Edge types as indices into the vocabulary given to `read`."""
    source: np.ndarray
    """[S] Site or scenario of each scene."""
    split: np.ndarray
    """[S] `train`, `validation` or `test`."""
    vehicle: np.ndarray
    """[S, N] Numbers of the vehicles."""
    length: Float[Tensor, "S N"]
    """Vehicle lengths [m]; 0 if not recorded."""
    hypothesis: Int[Tensor, "S E"] | None = None
    """Edge types that the geometry suggests; None if the file does not contain them."""
    unambiguous: Bool[Tensor, " S"] | None = None
    """Whether the graph contains all relations of the scene's steps; None if the file does not have graphs per step."""

    def __len__(self) -> int:
        return len(self.graph)

    def __getitem__(self, scenes: Int[Tensor, " K"]) -> "Recorded":
        """The selected scenes."""
        given = {name: value for name, value in vars(self).items() if name != "trajectory" and value is not None}
        rows = scenes.numpy()
        return Recorded(self.trajectory[scenes], **{name: value[rows] for name, value in given.items()})


def read(path: Path, kind: str, dynamics: Dynamics, vocabulary: Vocabulary, split: str | None = None) -> Recorded:
    """All scenes of a kind, and of `split` if that is given, as states of `dynamics` and types of `vocabulary`.

    Errors: `InputError` if the file is not a scene file, has no such scenes or scenes of different T, does not have a
    feature of the state, or has an edge type outside the vocabulary.
    """
    with guarded_reading(path, "scene file", "make it again"):
        header = read_header(opened(path), path)
        n = header.vehicles
        filters = _filters(kind, split)
        names = ["scene", "step", "valid", "source", "split", "vehicle", "length", *dynamics.state]
        known = set(opened(path).schema_arrow.names)
        more = [*(f"{word}_from_{i}" for word in ("edge", "hypothesis") for i in range(n)), "unambiguous"]
        table = pq.read_table(path, columns=[*names, *(name for name in more if name in known)], filters=filters)
        if not table.num_rows:
            raise InputError(f"{path}: has no scenes of kind {kind}{f' in split {split}' if split else ''}; make some")
        steps = int(table["step"].to_numpy().max()) + 1
        if table.num_rows % (n * steps) or np.any(np.diff(table["scene"].to_numpy()[:: n * steps]) <= 0):
            raise InputError(
                f"{path}: got scenes of kind {kind} with different numbers of steps, wanted one; write a file for each"
            )
        shape = (-1, n, steps)
        for name in dynamics.state:
            if table[name].null_count:
                raise InputError(
                    f"{path}: column {name} has missing values for kind {kind}; {dynamics.name} needs all of them"
                )
        state = np.stack([table[name].to_numpy().reshape(shape) for name in dynamics.state], -1)
        valid = table["valid"].to_numpy(zero_copy_only=False).reshape(shape)
        if np.any(table["step"].to_numpy().reshape(shape) != np.arange(steps)) or valid.dtype != bool:
            raise InputError(
                f"{path}: got steps that do not count from 0, or valid that is no truth value; make it again"
            )
        with np.errstate(invalid="ignore"):
            finite = np.isfinite(state.astype(float)[valid]).all()
        if not finite:
            raise InputError(f"{path}: has states that are not finite for kind {kind}; make the file again")
        first = {name: table[name].to_numpy(zero_copy_only=False).reshape(shape)[:, :, 0] for name in names[3:7]}

        def graph_of(word: str) -> Tensor:
            columns = [table[f"{word}_from_{i}"].to_numpy(zero_copy_only=False).reshape(shape) for i in range(n)]
            return torch.from_numpy(_indices(np.stack([columns[i][:, j, 0] for i, j in pairs(n)], 1), vocabulary, path))

        reduced = "unambiguous" in known and not table["unambiguous"].null_count
        return Recorded(
            Trajectory(torch.from_numpy(state).float(), torch.from_numpy(valid.copy()), header.dt),
            graph_of("edge"),
            first["source"][:, 0],
            first["split"][:, 0],
            first["vehicle"],
            torch.from_numpy(np.nan_to_num(first["length"].astype(np.float32))),
            graph_of("hypothesis") if reduced else None,
            torch.from_numpy(table["unambiguous"].to_numpy().reshape(shape)[:, 0, 0].copy()) if reduced else None,
        )


def scene_numbers(path: Path, kind: str, split: str | None = None) -> Int[np.ndarray, " S"]:
    """The numbers in their file of the scenes that `read` reads."""
    with guarded_reading(path, "scene file", "make it again"):
        read_header(opened(path), path)
        table = pq.read_table(path, columns=["scene"], filters=_filters(kind, split))
        return np.unique(table["scene"].to_numpy())


def has_step_edges(path: Path, kind: str) -> bool:
    """Whether all scenes of a kind have edges that change from step to step."""
    with guarded_reading(path, "scene file", "make it again"):
        name = "step_edge_from_0"
        if name not in opened(path).schema_arrow.names:
            return False
        column = pq.read_table(path, columns=[name], filters=[("kind", "=", kind), ("role", "=", 1)])[name]
        return column.null_count == 0 and len(column) > 0


def _filters(kind: str, split: str | None) -> list[tuple[str, str, str]]:
    return [("kind", "=", kind)] + ([("split", "=", split)] if split else [])


def read_step_edges(path: Path, kind: str, vocabulary: Vocabulary, split: str | None) -> Int[np.ndarray, "S E T"]:
    """Edge types of every step, as indices into the vocabulary, of the scenes that `read` reads.

    Errors: `InputError` if the file does not have them, or has an edge type outside the vocabulary.
    """
    with guarded_reading(path, "scene file", "make it again"):
        n = read_header(opened(path), path).vehicles
        table = _columns(path, [f"step_edge_from_{i}" for i in range(n)], kind, split)
        columns = [table[:, :, :, i] for i in range(n)]
        names = np.stack([columns[i][:, j] for i, j in pairs(n)], 1)
        if any(name is None for name in names.ravel()):
            raise InputError(f"{path}: has no edges per step for kind {kind}; make the file again")
        return _indices(names.reshape(len(names), -1), vocabulary, path).reshape(names.shape)


def read_lateral(path: Path, kind: str, split: str) -> Float[np.ndarray, "S N T"]:
    """Lateral positions y [m] of the scenes that `read` reads."""
    with guarded_reading(path, "scene file", "make it again"):
        return _columns(path, ["y"], kind, split)[..., 0].astype(float)


def _columns(path: Path, names: Sequence[str], kind: str, split: str | None) -> np.ndarray:
    """[S, N, T, C] Columns of the scenes of a kind and split, all of one number of steps."""
    vehicles = read_header(opened(path), path).vehicles
    table = pq.read_table(path, columns=["step", *names], filters=_filters(kind, split))
    shape = (-1, vehicles, int(table["step"].to_numpy().max()) + 1)
    return np.stack([table[name].to_numpy(zero_copy_only=False).reshape(shape) for name in names], -1)


def scene_counts(path: Path) -> set[tuple[str, str]]:
    """The pairs (kind, split) for which a file has scenes. Errors: `InputError` if it is not a scene file."""
    with guarded_reading(path, "scene file", "make it again"):
        read_header(opened(path), path)
        table = pq.read_table(path, columns=["kind", "split"]).unify_dictionaries()
        found = table.group_by(["kind", "split"]).aggregate([])
        return set(zip(found["kind"].to_pylist(), found["split"].to_pylist(), strict=True))


def joined(parts: Sequence[Recorded]) -> Recorded:
    """All scenes of the parts, in order; their N, T and Δt must agree."""
    first = parts[0].trajectory
    state, valid = (torch.cat([getattr(p.trajectory, name) for p in parts]) for name in ("state", "valid"))
    return Recorded(
        Trajectory(state, valid, first.dt),
        torch.cat([part.graph for part in parts]),
        np.concatenate([part.source for part in parts]),
        np.concatenate([part.split for part in parts]),
        np.concatenate([part.vehicle for part in parts]),
        torch.cat([part.length for part in parts]),
        _all_of([part.hypothesis for part in parts]),
        _all_of([part.unambiguous for part in parts]),
    )


def _all_of(parts: Sequence[Tensor | None]) -> Tensor | None:
    """The concatenated parts; None if a part is None."""
    present = [part for part in parts if part is not None]
    return torch.cat(present) if len(present) == len(parts) else None


def _indices(names: np.ndarray, vocabulary: Vocabulary, path: Path) -> np.ndarray:
    """Names [S, E] as indices into the vocabulary."""
    unknown = set(names.ravel().tolist()) - {str(kind) for kind in vocabulary}
    if unknown:
        wanted = ", ".join(vocabulary)
        raise InputError(f"{path}: got edge type {sorted(map(str, unknown))[0]}, wanted one of {wanted}")
    index = {str(kind): k for k, kind in enumerate(vocabulary)}
    return np.vectorize(index.__getitem__, otypes=[np.int64])(names)
