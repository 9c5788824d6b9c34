"""A round that is ready to be driven, and what is seen of it while it is driven."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

from cosim.loop.intervention import Intervention, NoIntervention, Observed
from cosim.loop.membership import Membership
from cosim.loop.nearby_vehicles import Around
from cosim.loop.observation import GroupObservation
from cosim.loop.round_recorder import Round
from cosim.loop.take_over_and_hand_back import Control
from cosim.world.snapshot import Snapshot, StepReport
from cosim.world.surroundings import Instant


@dataclass(frozen=True)
class RoundStart:
    """A round that is ready to be driven, or to be recorded while SUMO drives.

    `control` moves the driven vehicles, `intervention` perturbs the round, `now` is the take-over, `observations` are
    the history up to it. Driving uses a start up; branches of the process may share it. `members` are those of groups
    that others may join, None where the groups end instead.
    """

    control: Control
    intervention: Intervention | NoIntervention
    now: Snapshot
    observations: tuple[GroupObservation, ...]
    members: Membership | None = None

    @property
    def round(self) -> Round:
        return self.intervention.round


def around_of(
    intervention: Intervention | NoIntervention, now: Snapshot, members: Sequence[Collection[str]] | None = None
) -> Around:
    """The vehicles near the round, the members of its groups, and where the lane of a merge ends.

    `members` are those of groups that others may join.
    """
    this_round, lanes = intervention.round, intervention.round.lanes
    if members is None:
        members = [intervention.members(g, now) for g in range(len(this_round.groups))]
    end = lanes.source.end if lanes is not None and lanes.ends else None
    return Around(now, members, end, lanes.side if lanes is not None else 1)


@dataclass
class Seen:
    """What was observed so far: groups (history included), vehicles to record, and vehicles near after the take-over.

    `now` is the last of them.
    """

    now: Snapshot
    observations: list[GroupObservation]
    around: list[Snapshot | Instant]
    trace: list[Snapshot] = field(default_factory=list)

    @classmethod
    def at_start(cls, start: RoundStart) -> "Seen":
        """At the take-over."""
        return cls(start.now, [*start.observations], [start.now])

    @property
    def steps(self) -> int:
        """Steps since the take-over."""
        return len(self.trace)

    def add(self, now: Snapshot, observation: GroupObservation, recorded: Snapshot | Instant) -> None:
        """Add what was observed after a step."""
        self.now = now
        self.observations.append(observation.with_last_known_states(self.observations[-1]))
        self.around.append(recorded)
        self.trace.append(now)


@dataclass(frozen=True)
class Made:
    """A step that was made, and in which something may have happened."""

    observed: Observed
    report: StepReport
