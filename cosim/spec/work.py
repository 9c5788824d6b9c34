"""How much work a run can be at most, and the limits beyond which it is refused before it starts.

Every field of a scenario has a range, but the product of several values can still be a run that never ends or fills the
memory. The limits are far above what a study needs; a scenario's `max_work` raises them.
"""

import math
from dataclasses import dataclass

from cosim.spec.demand import Flow, Traffic

HOUR = 3600.0  # [s]


@dataclass(frozen=True)
class Work:
    """What a run needs at most: `steps` to simulate, `vehicles` that enter, and `states` to keep in memory.

    A state is that of one vehicle at one instant.
    """

    steps: int
    vehicles: int
    states: int


LIMITS = Work(steps=2_000_000, vehicles=500_000, states=20_000_000)
"""Two million steps take hours, half a million vehicles are a day of a wide freeway, 20 million states are 4 GB."""
_ADVICE = {
    "steps": ("steps", "give a longer step, or a shorter warm_up or time_limit"),
    "vehicles": ("vehicles", "give smaller flows (per_hour), or a shorter warm_up or time_limit"),
    "states": ("vehicle states in memory", "give fewer episodes, a longer step, or a shorter history or horizon"),
}


def entering(traffic: Traffic, end: float) -> float:
    """The number of vehicles that enter until `end` [s]."""
    return sum((_entering(flow, traffic.interval, end) for flow in traffic.flows), start=0.0)


def _entering(flow: Flow, interval: float, end: float) -> float:
    within = [min(max(end - k * interval, 0), interval) for k in range(len(flow.per_hour))]  # [s] of each interval
    after = max(end - len(within) * interval, 0)  # the last rate continues
    rates = zip(flow.per_hour, within, strict=True)
    return (sum(rate * seconds for rate, seconds in rates) + flow.per_hour[-1] * after) / HOUR


def refuse_too_much(work: Work, times: float) -> None:
    """Raise `ValueError` for more than `times` the usual limits."""
    for name, (what, advice) in _ADVICE.items():
        needed, limit = getattr(work, name), getattr(LIMITS, name)
        if needed > times * limit:
            raise ValueError(
                f"the run may need {needed:,} {what}, more than {times * limit:,.0f}; {advice}; or allow it with"
                f" max_work: {math.ceil(needed / limit)} (option --max-work)"
            )
