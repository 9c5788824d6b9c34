"""Vehicles near a group for the tests of the safety filter and of reference drivers."""

from collections.abc import Sequence

import numpy as np

from cosim.loop.near_vehicles import Lookout, NearVehicles
from cosim.loop.state_layouts import Pose
from cosim.world.groups import Group
from cosim.world.snapshot import Snapshot

FAR = 1000.0  # [m]
Vehicle = tuple[float, float, float, float]  # s, d [m], v, lateral speed [m/s]


def snapshot(vehicles: Sequence[Vehicle], time: float, dt: float = 0.0) -> Snapshot:
    """Vehicles "a", "b", …, 5 m × 2 m, `dt` [s] before they are where said."""
    s, d, v, across = np.array(vehicles, dtype=float).T
    n = len(vehicles)
    return Snapshot(
        time=time - dt,
        ids=tuple("abcdefgh"[:n]),
        xy=np.zeros((n, 2)),
        heading=np.zeros(n),
        v=v,
        a=np.zeros(n),
        s=s - v * dt,
        d=d - across * dt,
        length=np.full(n, 5.0),
        width=np.full(n, 2.0),
        lane=("",) * n,
    )


def near(
    own: Vehicle,
    *others: Vehicle,
    a: float = 0.0,
    members: Sequence[Vehicle] = ((-FAR, 0.0, 10.0, 0.0), (FAR, 0.0, 10.0, 0.0)),
) -> NearVehicles:
    """Vehicle 0 of a group at `own`, the other members, by default far away, and others."""
    members = [own, *members]
    lookout = Lookout([Group(tuple("abcdefgh"[: len(members)]), 0.0)])
    s, d, v, across = (np.array([column]) for column in zip(*members, strict=True))
    pose = Pose(s, d, np.arcsin(across / np.maximum(v, 1e-9)), v, np.array([[a] + [0.0] * (len(members) - 1)]))
    lookout.look(snapshot([*members, *others], 0.0, dt=0.2), pose)
    return lookout.look(snapshot([*members, *others], 0.0), pose)
