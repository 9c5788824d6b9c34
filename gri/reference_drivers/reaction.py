"""From a judgement to the brake: a reference driver judges, reacts, and then brakes harder step by step."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from gri.reference_drivers.drivers import Judgement, ReferenceDriver


@dataclass(frozen=True)
class Reaction:
    """What a driver remembers, elementwise.

    `seen` [s] is for how long a risk has been seen without a break, `waited` [s] how much of the reaction time has
    passed, `braking` [m/s²] the deceleration so far. `alert` says whether it has reacted to anything yet.
    """

    seen: Float[np.ndarray, "*batch"]
    waited: Float[np.ndarray, "*batch"]
    braking: Float[np.ndarray, "*batch"]
    alert: Bool[np.ndarray, "*batch"]

    @classmethod
    def none(cls, *shape: int) -> "Reaction":
        """Nothing seen yet."""
        return cls(np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=bool))

    def forgotten(self, where: Bool[np.ndarray, "*batch"]) -> "Reaction":
        """The same, with nothing seen where said."""
        numbers = {name: np.where(where, 0.0, getattr(self, name)) for name in ("seen", "waited", "braking")}
        return replace(self, alert=self.alert & ~where, **numbers)


def react(
    driver: ReferenceDriver, judged: Judgement, before: Reaction, dt: float
) -> tuple[Float[np.ndarray, "*batch"], Reaction]:
    """The deceleration of the next `dt` [s] in m/s², 0 where the driver does not brake, and the new memory.

    The reaction time passes only while there is a risk. A driver whose risk goes away releases the brake, and
    brakes on from its last deceleration if the risk comes back.
    """
    seen = np.where(judged.risk, before.seen + dt, 0.0)
    risk = judged.risk & (seen > driver.judging + 1e-9)
    waiting = risk & (before.waited < driver.reaction)
    braking = risk & ~waiting
    harder = np.minimum(before.braking + driver.jerk * dt, judged.braking)
    level = np.where(braking, harder, np.where(waiting, driver.release, before.braking))
    waited = np.where(waiting, before.waited + dt, before.waited)
    return np.where(risk, level, 0.0), Reaction(seen, waited, level, before.alert | risk)
