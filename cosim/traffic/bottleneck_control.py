"""Moving the limits of a bottleneck while the simulation runs."""

import numpy as np

from cosim.spec.demand import Bottleneck
from cosim.sumo import Sumo
from cosim.traffic.bottleneck_limits import LOWEST, PERIOD, HeldSpeed, base_limits, pulse_limits


class BottleneckControl:
    """Sets the limits of a bottleneck before a step, once per PERIOD; copies of the process go on with their own.

    Gradual limits move in every step: they reach the value of a period in its last step, from that of the one before.
    """

    def __init__(
        self, world: Sumo, bottleneck: Bottleneck, interval: float, seed: int, end: float, step: float
    ) -> None:
        """`interval` [s] is that of the demand, `end` [s] the last time with limits, `step` [s] SUMO's."""
        self._world, self._lanes, self._step, self._steps = world, bottleneck.lanes, step, 0
        self._base = base_limits(bottleneck, interval, seed, end)
        self._allowed = pulse_limits(bottleneck, seed, end)
        self._edges = () if bottleneck.hold is None else bottleneck.hold.edges
        self._held = None if bottleneck.hold is None else HeldSpeed(bottleneck.hold, interval)
        self._changes = 0
        self._gradual = bottleneck.changes == "gradual"
        self._last = self._next = np.empty(0)  # limits at the beginning and at the end of the period

    def before_step(self) -> None:
        """To be called before every step."""
        time, self._steps = self._steps * self._step, self._steps + 1
        if time >= self._changes * PERIOD - 1e-6:
            self._begin_period()
            if not self._gradual:
                self._world.set_limits(self._lanes, self._next.tolist())
        if self._gradual:
            passed = min((time + self._step - (self._changes - 1) * PERIOD) / PERIOD, 1.0)
            limits = self._last + passed * (self._next - self._last)
            self._world.set_limits(self._lanes, limits.tolist())

    def _begin_period(self) -> None:
        """The limits of the next period."""
        row = min(self._changes, len(self._base) - 1)
        self._changes += 1
        factor = 1.0
        if self._held is not None:
            self._held.observe(*self._world.speeds_on(self._edges))
            factor = self._held.factor()
        limits = np.maximum(np.minimum(self._base[row] * factor, self._allowed[row]), LOWEST)
        self._last, self._next = (self._next if len(self._next) else limits), limits
