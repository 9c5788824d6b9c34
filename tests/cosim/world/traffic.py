"""Hand-made traffic on a straight road along x, three lanes 3.5 m apart."""

from collections.abc import Mapping

import numpy as np

from cosim.world.episode import COLUMNS, Ending, Episode
from cosim.world.groups import Group
from cosim.world.snapshot import Snapshot

LANE = 3.5  # [m]


def snapshot(time: float, **vehicles: tuple[float, ...]) -> Snapshot:
    """Vehicles of 5 m × 1.8 m by id: s, d and, if it is not 10 m/s, v."""
    s, d, v = (np.array([(*x, 10.0)[k] for x in vehicles.values()]) for k in range(3))
    n = np.ones(len(vehicles))
    lanes = tuple(f"e_{round(x / LANE)}" for x in d)
    return Snapshot(time, tuple(vehicles), np.stack([s, d], 1), 0 * n, v, 0 * n, s, d, 5 * n, 1.8 * n, lanes)


def episode(
    ending: Ending, end: float, *, last: float = 0.0, order=(0, 1, 2), s: Mapping[int, float] | None = None, **changes
) -> Episode:
    """An episode of the group a, b, c that was taken over at t = 0 and watched until `last` s."""
    time = np.round(np.arange(0, max(end, last) + 0.1, 0.2), 10)
    state = np.zeros((len(time), 3, len(COLUMNS)))
    state[..., COLUMNS.index("s")] = [(s or {}).get(role, 20.0 * role) for role in range(3)]
    return Episode(
        driver="test",
        group=Group(("a", "b", "c"), 0.0),
        time=time,
        state=state,
        valid=np.ones((len(time), 3), dtype=bool),
        driven=np.zeros((len(time), 3), dtype=bool),
        length=np.full(3, 5.0),
        width=np.full(3, 1.8),
        order=order,
        graph=None,
        graph_time=np.empty(0),
        ending=ending,
        end=end,
        events=(),
        **changes,
    )
