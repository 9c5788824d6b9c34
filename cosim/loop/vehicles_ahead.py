"""Vehicles ahead of the driven groups move in a branch as they do in the trunk.

Nothing that a policy does reaches a vehicle ahead of it, except through SUMO's random numbers: SUMO draws the
imperfection of its drivers from one stream per lane, so a vehicle that enters a lane one step earlier changes what all
other vehicles of that lane draw. The trunk therefore records the speeds of the vehicles ahead, and a branch asks their
drivers for these speeds. SUMO's safe speed still bounds them, so they brake for a vehicle that comes between them.

docs/decisions/048-isolated-groups.md has the measurements.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import compress

import numpy as np
from jaxtyping import Float

from cosim.sumo import Sumo
from cosim.world.groups import Group
from cosim.world.snapshot import Snapshot


def vehicles_ahead(groups: Sequence[Group], now: Snapshot) -> tuple[str, ...]:
    """The leader of the groups that is farthest back, and all vehicles beside it or ahead of it."""
    rearmost = now.s[[now.row_of[group.leader] for group in groups]].min()
    return tuple(compress(now.ids, now.s >= rearmost))


@dataclass(frozen=True)
class SpeedRecord:
    """Speeds [m/s] of `vehicles` after each step from the take-over on; `record` adds a step."""

    vehicles: tuple[str, ...]
    steps: list[Mapping[str, float]] = field(default_factory=list)

    def record(self, world: Sumo) -> None:
        """Add the speeds after the step that was just made."""
        self.steps.append(world.speeds(self.vehicles))

    def add(self, speeds: Float[np.ndarray, "K L"]) -> None:
        """Add K steps [m/s], nan for a vehicle that is gone."""
        for step in speeds.tolist():
            found = zip(self.vehicles, step, strict=True)
            self.steps.append({vehicle: speed for vehicle, speed in found if speed == speed})

    def of(self, vehicles: Collection[str]) -> "SpeedRecord":
        """The same record for some of its vehicles."""
        return SpeedRecord(tuple(vehicle for vehicle in self.vehicles if vehicle in vehicles), self.steps)

    def repeat(self, world: Sumo, step: int) -> None:
        """Ask the drivers, before the step of this number, for the recorded speeds; after the last one for none."""
        if step <= len(self.steps):
            world.ask_for_speeds(self.vehicles, self.steps[step] if step < len(self.steps) else {})
