"""Drivers that do not decide at every simulation step: what they carry out is what they decided last.

An intervention of one step shows an effect only at the steps at which a driver decides. SUMO's drivers decide every
`actionStepLength`. Drivers of the extended intelligent driver model (EIDM) also have a reaction time of .5 s: in
between they go on with the leader they saw last (Salles, Kaufmann and Reuss 2020; MSCFModel_EIDM, `myap_update`). So
the effect of a cause lasts until the next decision, or until the cause is gone.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from cosim.measures.relation_labels import NO_VEHICLE

SMALLEST_EFFECT = 1e-9  # [m/s²]; a smaller one is rounding


@dataclass
class _Decision:
    """The last decision of one driver: who caused an effect, the effect [m/s²], and how many steps ago."""

    cause: int
    effect: float
    age: int
    seen: int
    """Steps since the driver appeared."""


class LastDecisions:
    """Effects of the last decisions of all drivers, for one kind of cause; updated at every simulation step."""

    def __init__(self) -> None:
        self._of: dict[int, _Decision] = {}

    def update(
        self,
        vehicle: Int[np.ndarray, " V"],
        cause: Int[np.ndarray, " V"],
        effect: Float[np.ndarray, " V"],
        steps: Int[np.ndarray, " V"],
    ) -> tuple[Float[np.ndarray, " V"], Bool[np.ndarray, " V"]]:
        """The effect in force for each vehicle, and whether its last decision is known.

        `cause` are numbers of vehicles (leaders, requesters), or `NO_VEHICLE`. `effect` [m/s²] is what an intervention
        of one step shows; `steps` are simulation steps from decision to decision. The decision of a vehicle that just
        appeared is unknown until it decides. An effect is in force only while its cause is the same.
        """
        held, known, now = effect.copy(), steps <= 1, {}
        for row in np.flatnonzero(steps > 1).tolist():
            number = int(vehicle[row])
            before = self._of.get(number, _Decision(NO_VEHICLE, 0.0, int(steps[row]), 0))
            if abs(effect[row]) > SMALLEST_EFFECT:
                last = _Decision(int(cause[row]), float(effect[row]), 0, int(steps[row]))
            else:
                last = _Decision(before.cause, before.effect, before.age + 1, before.seen + 1)
                if last.age < steps[row] and last.cause == cause[row]:
                    held[row] = last.effect
            known[row] = last.seen >= steps[row]
            now[number] = last
        self._of = now
        return held, known
