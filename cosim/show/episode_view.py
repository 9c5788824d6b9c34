"""One episode out of the tables of a run: the view that pictures, films, animations and words share."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from cosim.world.episode import COLUMNS
from gri.errors import InputError

ROLES = 3


@dataclass(frozen=True)
class Belief:
    """What the policy took a pair for from an instant on: `receiver` does `type` towards `sender`."""

    time: float
    sender: int
    receiver: int
    type: str
    probability: float


@dataclass(frozen=True)
class View:
    """An episode as arrays: per instant and role the features of COLUMNS, and gap and TTC where there is one ahead."""

    number: int
    driver: str
    group: Mapping[str, Any]
    time: Float[np.ndarray, " T"]
    state: Float[np.ndarray, "T 3 C"]
    present: Bool[np.ndarray, "T 3"]
    driven: Bool[np.ndarray, "T 3"]
    during_drive: Bool[np.ndarray, " T"]
    gap: Float[np.ndarray, "T 3"]
    ttc: Float[np.ndarray, "T 3"]
    beliefs: tuple[Belief, ...]

    def feature(self, name: str) -> Float[np.ndarray, "T 3"]:
        return self.state[..., COLUMNS.index(name)]

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(self.group[f"vehicle_{role}"] for role in range(ROLES))

    @property
    def length(self) -> Float[np.ndarray, " 3"]:
        return np.array([self.group[f"length_{role}"] for role in range(ROLES)])

    @property
    def width(self) -> Float[np.ndarray, " 3"]:
        return np.array([self.group[f"width_{role}"] for role in range(ROLES)])

    @property
    def taken(self) -> float:
        """When the group was taken [s]."""
        return float(self.group["takeover_time"])


def view(tables: Mapping[str, pd.DataFrame], number: int, driver: str | None = None) -> View:
    """One episode of a run; without a driver, as the run's policy drove it."""
    groups = tables["groups"]
    driver = driver or str(groups["driver"].iloc[0])
    found = groups[(groups["episode"] == number) & (groups["driver"] == driver)]
    if not len(found):
        known = groups.loc[groups["driver"] == driver, "episode"]
        raise InputError(f"--episode: got {number}, this run has the episodes {known.min()} to {known.max()}")
    rows = _of(tables["steps"], number, driver).sort_values(["time", "role"])
    shape = (len(rows) // ROLES, ROLES)

    def wide(column: str) -> np.ndarray:
        return rows[column].to_numpy().reshape(shape)

    return View(
        number=number,
        driver=driver,
        group={str(key): value for key, value in found.iloc[0].to_dict().items()},
        time=wide("time")[:, 0],
        state=np.stack([wide(name) for name in COLUMNS], -1),
        present=wide("present"),
        driven=wide("driven"),
        during_drive=wide("during_drive")[:, 0],
        gap=wide("gap"),
        ttc=wide("ttc"),
        beliefs=_beliefs(tables, number, driver),
    )


def _of(table: pd.DataFrame, number: int, driver: str) -> pd.DataFrame:
    return table[(table["episode"] == number) & (table["driver"] == driver)]


def _beliefs(tables: Mapping[str, pd.DataFrame], number: int, driver: str) -> tuple[Belief, ...]:
    columns = ["time", "sender", "receiver", "type", "probability"]
    rows = _of(tables["graphs"], number, driver)[columns].to_numpy().tolist()
    return tuple(Belief(float(time), int(i), int(j), str(kind), float(p)) for time, i, j, kind, p in rows)
