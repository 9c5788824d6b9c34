"""What stands between a policy's action and the vehicle: a reference driver's reaction, and the safety filter."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from cosim.loop.limits import FilterRecord, planned_across, within
from cosim.loop.near_vehicles import Lookout
from cosim.loop.reference_reaction import ReferenceReaction
from cosim.loop.round_recorder import Round
from cosim.loop.safety_filter import SafetyFilter
from cosim.loop.state_layouts import Layout
from cosim.spec.scenario import RssFilter
from cosim.world.episode import FilterUse
from cosim.world.snapshot import Snapshot
from gri.reference_drivers.drivers import DriverName


@dataclass(frozen=True)
class Guard:
    """Changes the actions of the driven vehicles of a round, from the true states of all vehicles near them.

    First the `reference` driver brakes, then the `safety` filter limits what is left; `dt` [s] is the step.
    """

    lookout: Lookout
    reference: ReferenceReaction | None
    safety: SafetyFilter | None
    dt: float
    record: FilterRecord = field(default_factory=FilterRecord)

    def change(
        self, state: Float[np.ndarray, "G N D"], action: Float[np.ndarray, "G N A"], now: Snapshot, layout: Layout
    ) -> Float[np.ndarray, "G N A"]:
        """The actions that the vehicles carry out instead of the policy's; `state` is that of the model."""
        near = self.lookout.look(now, layout.pose(state))
        if self.reference is not None:
            action = within(self.reference.limits(near), state, action, layout, self.dt).action
        if self.safety is not None:
            wanted = planned_across(state, action, layout, self.dt)
            limited = within(self.safety.limits(near, wanted), state, action, layout, self.dt)
            self.record.add(now.time, limited)
            action = limited.action
        return action

    def use(self, group: int, roles: list[int], end: float) -> FilterUse | None:
        """How the safety filter was used in a group until its `end` [s]; None without one."""
        return None if self.safety is None else self.record.of(group, roles, end)


def guard_of(reference: DriverName | None, safety: RssFilter | None, this_round: Round) -> Guard | None:
    """The guard of a round; None where nothing stands between policy and vehicles."""
    if reference is None and safety is None:
        return None
    dt, lanes = this_round.dt, this_round.lanes
    beside = lanes if lanes is not None and lanes.path is None else None  # on a ramp of its own nobody is beside it
    return Guard(
        lookout=Lookout(this_round.groups),
        reference=None
        if reference is None
        else ReferenceReaction(reference, len(this_round.groups), dt, this_round.size),
        safety=None if safety is None else SafetyFilter(safety, dt, beside),
        dt=dt,
    )
