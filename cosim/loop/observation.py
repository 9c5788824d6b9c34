"""What is seen of the groups of a round at one instant."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from cosim.world.episode import COLUMNS
from cosim.world.groups import Group
from cosim.world.snapshot import Snapshot


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
        valid = rows >= 0
        if -1 not in found:
            return cls(snapshot.time, snapshot.features(rows), valid, rows)
        rows = np.maximum(rows, 0)
        if not where:  # nobody at all
            return cls(snapshot.time, np.zeros((*rows.shape, len(COLUMNS))), valid, rows)
        return cls(snapshot.time, np.where(valid[..., None], snapshot.features(rows), 0.0), valid, rows)

    @cached_property
    def complete(self) -> bool:
        """Whether everybody is there."""
        return bool(self.valid.all())

    def carried_on(self, previous: "Frame") -> "Frame":
        """With the last known state of vehicles that are gone; `valid` keeps saying that they are."""
        if self.complete:
            return self
        return replace(self, state=np.where(self.valid[..., None], self.state, previous.state))
