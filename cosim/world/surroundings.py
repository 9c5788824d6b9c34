"""The vehicles around a group, from its take-over until some seconds after its hand-back."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from cosim.world.snapshot import COLUMNS, Snapshot

REACH = 150.0  # [m] along the road, behind the rearmost and ahead of the foremost vehicle of a group


@dataclass(frozen=True)
class Instant:
    """All V vehicles at one instant as they are recorded: `state` has the features of COLUMNS, sizes are in m."""

    time: float
    ids: tuple[str, ...]
    state: Float[np.ndarray, "V C"]
    length: Float[np.ndarray, " V"]
    width: Float[np.ndarray, " V"]


@dataclass(frozen=True)
class Surroundings:
    """R observations of vehicles: one per instant and vehicle, in the order of time; the group's own are among them.

    `state` has the features of COLUMNS, `vehicle` is the index of the vehicle's id in `ids`. `length` and `width` are
    in m, `time` in s.
    """

    ids: tuple[str, ...]
    vehicle: Int[np.ndarray, " R"]
    time: Float[np.ndarray, " R"]
    state: Float[np.ndarray, "R C"]
    length: Float[np.ndarray, " R"]
    width: Float[np.ndarray, " R"]

    @classmethod
    def of(cls, snapshots: Sequence[Snapshot | Instant]) -> "Surroundings":
        """All vehicles of the snapshots."""
        number: dict[str, int] = {}
        vehicle, ids, codes = [], None, np.empty(0, dtype=np.int32)
        for now in snapshots:
            if now.ids is not ids and now.ids != ids:  # in most steps no vehicle enters or leaves
                ids = now.ids
                for name in ids:
                    if name not in number:
                        number[name] = len(number)
                codes = np.fromiter(map(number.__getitem__, ids), np.int32, len(ids))
            vehicle.append(codes)
        count = [len(codes) for codes in vehicle]
        return cls(
            ids=tuple(number),
            vehicle=np.concatenate(vehicle),
            time=np.repeat([now.time for now in snapshots], count),
            state=np.concatenate([now.state.T for now in snapshots], axis=1).T,  # each feature in one stretch of memory
            length=np.concatenate([now.length for now in snapshots]),
            width=np.concatenate([now.width for now in snapshots]),
        )

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, rows: Bool[np.ndarray, " R"] | Int[np.ndarray, " Q"] | slice) -> "Surroundings":
        """Some of the observations, with the ids as they are."""
        arrays = ("vehicle", "time", "length", "width")
        features = self.state.T[:, rows]
        return replace(self, state=features.T, **{name: getattr(self, name)[rows] for name in arrays})

    @cached_property
    def instants(self) -> tuple[Float[np.ndarray, " I"], Int[np.ndarray, " I"]]:
        """The times [s] of the observations, and the row at which the observations of each of them end."""
        last = np.flatnonzero(np.append(np.diff(self.time) > 0, len(self) > 0))
        return self.time[last], last + 1

    def feature(self, name: str) -> Float[np.ndarray, " R"]:
        """One of COLUMNS."""
        return self.state[:, COLUMNS.index(name)]

    def near(
        self, time: Float[np.ndarray, " T"], s: Float[np.ndarray, "T N"], begin: float, end: float
    ) -> "Surroundings":
        """The observations from `begin` to `end` [s] within REACH of a group along the road, in any lane.

        Args:
            time: instants [s] of the group, increasing; they include those observed here.
            s: positions [m] of its N vehicles at these instants.
        """
        when, ends = self.instants
        first, last = np.searchsorted(when, [begin - 1e-6, end + 1e-6])
        if first == last:
            return self[:0]
        begins = np.concatenate([[0], ends[:-1]])
        part, count = slice(begins[first], ends[last - 1]), (ends - begins)[first:last]
        at = np.searchsorted(time, when[first:last] - 1e-6)
        low, high = (np.repeat(bound[at], count) for bound in (s.min(axis=1) - REACH, s.max(axis=1) + REACH))
        own = self.feature("s")[part]
        return self[part.start + np.flatnonzero((own >= low) & (own <= high))]
