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
        where = snapshot.where
        found = [where.get(vehicle, -1) for group in groups for vehicle in group.ids]
        rows = np.array(found).reshape(-1, 3)
        if -1 not in found:
            return cls(snapshot.time, snapshot.table[rows], np.ones_like(rows, dtype=bool), rows)
        valid, rows = rows >= 0, np.maximum(rows, 0)
        if not where:  # nobody at all
            return cls(snapshot.time, np.zeros((*rows.shape, len(COLUMNS))), valid, rows)
        return cls(snapshot.time, np.where(valid[..., None], snapshot.table[rows], 0.0), valid, rows)

    def carried_on(self, previous: "Frame") -> "Frame":
        """With the last known state of vehicles that are gone; `valid` keeps saying that they are."""
        if self.valid.all():
            return self
        return replace(self, state=np.where(self.valid[..., None], self.state, previous.state))
