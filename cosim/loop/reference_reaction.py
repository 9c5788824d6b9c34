"""A reference driver in traffic: a base driver drives, the reference driver brakes for cut-ins and vehicles ahead."""

from dataclasses import fields

import numpy as np

from cosim.loop.limits import Limits
from cosim.loop.near_vehicles import NearVehicles
from cosim.spec.scenario import USUAL_SIZE
from gri.reference_drivers.drivers import DRIVERS, DriverName, Judgement, Situation
from gri.reference_drivers.reaction import Reaction, react

LANE = 3.66  # [m], the width of a lane of 12 feet
QUIET = 1.0  # [s] without a risk after which a driver begins anew
MOVING = 0.05  # [m/s] across the road, from which on a vehicle beside the lane moves over
NEAR_SIDE = 6.0  # [m] across the road, beyond which a vehicle is no matter


class ReferenceReaction:
    """The reactions of one reference driver in each vehicle of groups of one `size`; `dt` [s] is the step of the loop.

    Each driver judges all vehicles near it at once, and brakes as hard as the worst of them asks for. Unlike in the
    grid of cut-ins, the base driver goes on where there is no risk, and the reaction begins anew after a quiet second.
    """

    def __init__(self, name: DriverName, groups: int, dt: float, size: int = USUAL_SIZE) -> None:
        self._driver, self._dt = DRIVERS[name], dt
        self._memory, self._quiet = Reaction.none(groups, size), np.zeros((groups, size))
        self._last_v: np.ndarray | None = None

    def limits(self, near: NearVehicles) -> Limits:
        """The greatest accelerations [m/s²]: the braking of the reference driver, no limit where it sees no risk."""
        judged = self._driver.judge(self._situation(near))
        matter = near.other & (np.abs(near.d - near.pose.d[..., None]) < NEAR_SIDE)
        risk = judged.risk & matter
        worst = np.where(risk, judged.braking, 0.0).max(-1)
        anywhere = np.asarray(risk.any(-1))
        self._quiet = np.where(anywhere, 0.0, self._quiet + self._dt)
        everything = Judgement(anywhere, worst, np.zeros_like(anywhere))
        before = self._memory.forgotten(self._quiet > QUIET)
        deceleration, self._memory = react(self._driver, everything, before, self._dt)
        none = np.full(anywhere.shape, np.nan)
        return Limits(np.where(deceleration > 0, -deceleration, np.inf), none, np.full(anywhere.shape, -np.inf))

    def _situation(self, near: NearVehicles) -> Situation:
        pose, last = near.pose, self._last_v
        self._last_v = pose.v
        a = np.zeros_like(pose.v) if last is None else (pose.v - last) / self._dt
        lengths = near.length[..., None] + near.length_of
        centres = near.s - near.length_of / 2 - (pose.s - near.length / 2)[..., None]
        approach = -near.direction * near.across_of + np.zeros(near.other.shape)
        moved = LANE - np.abs(near.d - pose.d[..., None])
        values = {
            "centres": centres,
            "gap": np.abs(centres) - lengths / 2,
            "side": near.side_gap,
            "lengths": lengths,
            "v": pose.v[..., None],
            "v_other": near.v,
            "approach": approach,
            "wandered": np.where(approach > MOVING, moved, -np.inf),
            "a": a[..., None],
        }
        return Situation(**{f.name: np.broadcast_to(values[f.name], near.other.shape) for f in fields(Situation)})
