"""One episode from the tables of a run, as arrays: the common input of videos, animations and explanations."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from cosim.world.episode import COLUMNS
from cosim.world.outcome_columns import group_size
from gri.errors import InputError


@dataclass(frozen=True)
class InferredEdge:
    """An edge that the policy inferred: from `time` [s] on, `receiver` reacts to `sender` by `type` (or "none").

    One `in_doubt` is driven by although none is more probable.
    """

    time: float
    sender: int
    receiver: int
    type: str
    probability: float
    in_doubt: bool = False


@dataclass(frozen=True)
class EpisodeView:
    """One episode as arrays over T instants and N roles; SI units.

    `state` has the features of `cosim.world.episode.COLUMNS`; `gap` [m] and `ttc` [s] are to the vehicle ahead.
    """

    number: int
    driver: str
    group: Mapping[str, Any]
    time: Float[np.ndarray, " T"]
    state: Float[np.ndarray, "T N C"]
    present: Bool[np.ndarray, "T N"]
    driven: Bool[np.ndarray, "T N"]
    during_drive: Bool[np.ndarray, " T"]
    gap: Float[np.ndarray, "T N"]
    ttc: Float[np.ndarray, "T N"]
    inferred_edges: tuple[InferredEdge, ...]
    around: pd.DataFrame | None = None
    """Who else was near, by `time`: rows of the table `surroundings` but for the group; None where it is missing."""

    def feature(self, name: str) -> Float[np.ndarray, "T N"]:
        return self.state[..., COLUMNS.index(name)]

    @property
    def size(self) -> int:
        """N, the number of vehicles of the group."""
        return group_size(self.group)

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(self.group[f"vehicle_{role}"] for role in range(self.size))

    @property
    def length(self) -> Float[np.ndarray, " N"]:
        return np.array([self.group[f"length_{role}"] for role in range(self.size)])

    @property
    def width(self) -> Float[np.ndarray, " N"]:
        return np.array([self.group[f"width_{role}"] for role in range(self.size)])

    @property
    def takeover_time(self) -> float:
        """Simulation time of the take-over [s]."""
        return float(self.group["takeover_time"])


def episode_view(tables: Mapping[str, pd.DataFrame], number: int, *, counterpart: bool = False) -> EpisodeView:
    """Episode `number` of a run, or its counterpart, as arrays. Raises `InputError` for an unknown number."""
    groups, steps = tables["counterparts" if counterpart else "groups"], tables["steps"]
    found = groups[groups["episode"] == number]
    if not len(found):
        known = groups["episode"]
        raise InputError(f"--episode: got {number}, this run has the episodes {known.min()} to {known.max()}")
    rows = steps[(steps["episode"] == number) & (steps["counterpart"] == counterpart)].sort_values(["time", "role"])
    size, around = group_size(found.iloc[0].to_dict()), tables.get("surroundings")
    if around is not None:
        members = {found[f"vehicle_{role}"].iloc[0] for role in range(size)}
        around = around[(around["episode"] == number) & (around["counterpart"] == counterpart)]
        around = around[~around["vehicle"].isin(members)]
    shape = (len(rows) // size, size)

    def wide(column: str) -> np.ndarray:
        return rows[column].to_numpy().reshape(shape)

    return EpisodeView(
        number=number,
        driver=str(found["driver"].iloc[0]),
        group={str(key): value for key, value in found.iloc[0].to_dict().items()},
        time=wide("time")[:, 0],
        state=np.stack([wide(name) for name in COLUMNS], -1),
        present=wide("present"),
        driven=wide("driven"),
        during_drive=wide("during_drive")[:, 0],
        gap=wide("gap"),
        ttc=wide("ttc"),
        inferred_edges=() if counterpart else _inferred_edges(tables["graphs"], number),
        around=around,
    )


def _inferred_edges(graphs: pd.DataFrame, number: int) -> tuple[InferredEdge, ...]:
    columns = ["time", "sender", "receiver", "type", "probability", "in_doubt"]
    graphs = graphs if "in_doubt" in graphs else graphs.assign(in_doubt=False)  # runs before decision 076
    rows = graphs.loc[graphs["episode"] == number, columns].to_numpy().tolist()
    return tuple(
        InferredEdge(float(time), int(i), int(j), str(kind), float(p), bool(doubt))
        for time, i, j, kind, p, doubt in rows
    )


def same_start(tables: Mapping[str, pd.DataFrame], view: EpisodeView) -> int:
    """The episode of another run that starts from the same vehicles at the same time.

    Raises `InputError` if there is none.
    """
    groups = tables["groups"]
    same = (groups["takeover_time"] - view.takeover_time).abs() < 1e-6
    for role, vehicle in enumerate(view.ids):
        same &= groups[f"vehicle_{role}"] == vehicle
    if not same.any():
        raise InputError(
            f"--beside: got a run without the group {', '.join(view.ids)} taken over at {view.takeover_time:g} s; give"
            " a run of the same scenario and seed by another policy"
        )
    return int(groups.loc[same, "episode"].iloc[0])
