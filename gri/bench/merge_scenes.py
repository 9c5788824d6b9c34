"""Merges of scene files with the relations of every step, and controls in which a relation is broken on purpose."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gri.core.dynamics import DUBINS
from gri.core.edges import LANE_CHANGING, pairs
from gri.data.scene_file.schema import opened, read_header
from gri.errors import InputError
from gri.relations.broken_merges import (
    DEAF_LAG,
    OTHER_LANE,
    Impossible,
    Merges,
    apart,
    kept_in_lane,
    with_constant_speed,
    with_stranger,
)
from gri.relations.merge_motion import MergeMotion, lane_width_of, motion_of

PAIRS = pairs(3)


@dataclass(frozen=True)
class MergeScenes:
    """S scenes of one site: vehicle 0 changes lanes between a lag vehicle (1) and a leader (2)."""

    site: str
    dt: float
    lane_width: float
    """[m], the median way sideways of vehicles that change lanes."""
    state: Float[Tensor, "S 3 T D"]
    length: Float[Tensor, "S 3"]
    steps: Int[Tensor, "S T E"]
    """True relations of every step, indices into `gri.core.edges.LANE_CHANGING`."""
    graph: Int[Tensor, "S E"]
    """True relations of the scenes, as reduced by the file."""
    unambiguous: Bool[Tensor, " S"]
    recording: np.ndarray
    """[S] Seed of the simulation."""

    def __len__(self) -> int:
        return len(self.state)

    def __getitem__(self, scenes: Tensor) -> "MergeScenes":
        parts = {name: getattr(self, name)[scenes] for name in ("state", "length", "steps", "graph", "unambiguous")}
        return replace(self, **parts, recording=self.recording[scenes.numpy()])

    def motion(self) -> MergeMotion:
        """What the posterior sees."""
        return motion_of(self.state, self.lane_width, self.dt, self.length)


def read_merges(path: Path) -> MergeScenes:
    """All merges of a scene file. Errors: `InputError` if it has none, or no relations per step, or several sites."""
    header = read_header(opened(path), path)
    labels = [f"{word}_from_{i}" for word in ("step_edge", "edge") for i in range(3)]
    names = ["scene", "step", "source", "recording", "length", "unambiguous", *DUBINS.state, *labels]
    table = pq.read_table(path, columns=names, filters=[("kind", "=", "merge")])
    if not table.num_rows:
        raise InputError(f"{path}: has no merges; make some with `cosim scenes us101_merge --gold --kind merge`")
    if table["step_edge_from_0"].null_count == table.num_rows:
        raise InputError(f"{path}: its merges have no relations per step; give a file of `cosim scenes`")
    shape = (-1, 3, int(table["step"].to_numpy().max()) + 1)
    column = {name: table[name].to_numpy(zero_copy_only=False).reshape(shape) for name in names}
    sites = np.unique(column["source"])
    if len(sites) != 1:
        raise InputError(f"{path}: got merges of {', '.join(sites)}, wanted one site; give a file for each")
    state = torch.from_numpy(np.stack([column[name] for name in DUBINS.state], -1).astype(np.float64))
    code = {str(kind): k for k, kind in enumerate(LANE_CHANGING)}

    def relations(word: str) -> Int[Tensor, "S T E"]:
        found = np.stack([column[f"{word}_from_{i}"][:, j] for i, j in PAIRS], -1)
        return torch.from_numpy(np.vectorize(code.__getitem__, otypes=[np.int64])(found))

    return MergeScenes(
        site=str(sites[0]),
        dt=header.dt,
        lane_width=lane_width_of(state),
        state=state,
        length=torch.from_numpy(np.nan_to_num(column["length"][..., 0]).astype(np.float64)),
        steps=relations("step_edge"),
        graph=relations("edge")[:, 0],
        unambiguous=torch.from_numpy(column["unambiguous"][:, 0, 0].astype(bool)),
        recording=column["recording"][:, 0, 0].astype(str),
    )


def describe(path: Path, scenes: MergeScenes) -> dict[str, object]:
    """What a file contains: seeds, counts, and how often each relation occurs; and how it was made."""
    shares = {
        f"{i} to {j}": {
            str(kind): round(float((scenes.steps[..., e] == k).double().mean()), 4)
            for k, kind in enumerate(LANE_CHANGING)
        }
        for e, (i, j) in enumerate(PAIRS)
    }
    provenance = read_header(opened(path), path).provenance
    return {
        "site": scenes.site,
        "scenes": len(scenes),
        "unambiguous": int(scenes.unambiguous.sum()),
        "recordings": sorted(set(scenes.recording.tolist())),
        "steps": scenes.steps.shape[1],
        "lane_width_m": round(scenes.lane_width, 3),
        "share_of_steps": shares,
        "made_by": json.loads(json.dumps(provenance, default=str)).get("made by", ""),
    }


@dataclass(frozen=True)
class Control:
    """Scenes in which some relations cannot hold."""

    name: str
    scenes: MergeScenes
    impossible: Impossible
    after_change: bool = False
    """Whether only steps from the lane change on count."""


def controls(scenes: MergeScenes) -> list[Control]:
    """A stranger as lag vehicle; a lag vehicle at constant speed; the merging vehicle kept in its lane."""
    merges = Merges(scenes.state, scenes.length, scenes.lane_width, scenes.dt)
    codes = torch.from_numpy(np.unique(scenes.recording, return_inverse=True)[1])
    related = codes[:, None] == codes[None] if len(set(codes.tolist())) > 1 else torch.eye(len(codes)).bool()

    def of(broken: Merges) -> MergeScenes:
        return replace(scenes, state=broken.state, length=broken.length)

    stranger, constant = with_stranger(merges, related), with_constant_speed(merges)
    return [
        Control("a stranger as lag vehicle", of(stranger)[apart(stranger)], DEAF_LAG),
        Control("lag vehicle at constant speed", of(constant)[apart(constant)], DEAF_LAG),
        Control("merging vehicle kept in its lane", of(kept_in_lane(merges)), OTHER_LANE, after_change=True),
    ]
