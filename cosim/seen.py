"""What is seen of the groups of a round at one instant."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from cosim.episode import COLUMNS
from cosim.groups import Group
from cosim.snapshot import Snapshot


@dataclass(frozen=True)
class Frame:
    """The groups at one instant: features of COLUMNS, who is there, and their rows in the snapshot (0 where absent)."""

    time: float
    state: Float[np.ndarray, "G 3 C"]
    valid: Bool[np.ndarray, "G 3"]
    rows: Int[np.ndarray, "G 3"]

    @classmethod
    def of(cls, snapshot: Snapshot, groups: Sequence[Group]) -> "Frame":
        """The groups' part of a snapshot; absent vehicles have zeros."""
        where = {vehicle: row for row, vehicle in enumerate(snapshot.ids)}
        found = np.array([[where.get(vehicle, -1) for vehicle in group.ids] for group in groups])
        rows, valid = found.clip(min=0), found >= 0
        features = {"x": snapshot.xy[:, 0], "y": snapshot.xy[:, 1]}
        seen = np.zeros((max(len(snapshot.ids), 1), len(COLUMNS)))  # there may be nobody at all
        for column, name in enumerate(COLUMNS):
            seen[: len(snapshot.ids), column] = features[name] if name in features else getattr(snapshot, name)
        return cls(snapshot.time, np.where(valid[..., None], seen[rows], 0.0), valid, rows)

    def carried_on(self, previous: "Frame") -> "Frame":
        """With the last known state of vehicles that are gone; `valid` keeps saying that they are."""
        return replace(self, state=np.where(self.valid[..., None], self.state, previous.state))
