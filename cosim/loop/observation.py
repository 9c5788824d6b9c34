"""The vehicles of the groups of a round as they are observed at one instant."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import repeat

import numpy as np
from jaxtyping import Bool, Float, Int

from cosim.world.episode import COLUMNS
from cosim.world.groups import Group
from cosim.world.snapshot import Snapshot


@dataclass(frozen=True)
class GroupObservation:
    """All groups of a round at one instant.

    `state` has the features of COLUMNS, `valid` says which vehicles are present, `rows` are their rows in the snapshot
    (0 where a vehicle is absent).
    """

    time: float
    state: Float[np.ndarray, "G N C"]
    valid: Bool[np.ndarray, "G N"]
    rows: Int[np.ndarray, "G N"]

    @classmethod
    def of(cls, snapshot: Snapshot, groups: Sequence[Group]) -> "GroupObservation":
        """The groups' part of a snapshot; the state of absent vehicles is zero."""
        return cls.of_vehicles(snapshot, [vehicle for group in groups for vehicle in group.ids], len(groups))

    @classmethod
    def of_vehicles(cls, snapshot: Snapshot, vehicles: Sequence[str], groups: int) -> "GroupObservation":
        """The same for the vehicles of so many groups, one group after the other."""
        found = [*map(snapshot.row_of.get, vehicles, repeat(-1))]
        rows = np.array(found, dtype=int).reshape(groups, -1)
        valid = rows >= 0
        if -1 not in found:
            return cls(snapshot.time, snapshot.features(rows), valid, rows)
        rows = np.maximum(rows, 0)
        if not snapshot.ids:
            return cls(snapshot.time, np.zeros((*rows.shape, len(COLUMNS))), valid, rows)
        return cls(snapshot.time, np.where(valid[..., None], snapshot.features(rows), 0.0), valid, rows)

    @cached_property
    def complete(self) -> bool:
        """Whether all vehicles of all groups are present."""
        return bool(self.valid.all())

    def with_last_known_states(self, previous: "GroupObservation") -> "GroupObservation":
        """The observation with the last known state of absent vehicles, which remain marked as absent."""
        if self.complete:
            return self
        return replace(self, state=np.where(self.valid[..., None], self.state, previous.state))
