"""Windows of recorded car following as tensors, and windows broken on purpose, in which nobody can react.

A window has N vehicles in order along the road; vehicle N−1 is the foremost. `leader` says which vehicle of the window
each one follows by hypothesis. The functions that break a window are pure, and keep every vehicle's motion consistent:
x is the integral of v.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor

NOBODY = -1
HEADWAY = (6.0, 50.0)
"""Least and greatest headway of vehicles that could react to each other, front to front, all along [m]."""
MOST_SPEED_DIFFERENCE = 0.5
"""Of the mean speeds of a stranger and of the vehicle that it stands in for [m/s]."""
NEAREST = 60  # strangers by mean speed among whom one with a fitting motion is looked for


@dataclass(frozen=True)
class FollowingWindows:
    """S windows of N vehicles and T states, `dt` [s] apart."""

    state: Float[Tensor, "S N T 3"]
    """x [m], v [m/s], a [m/s²]. Net gaps are the recorded ones if every vehicle is 5 m long."""
    leader: Int[Tensor, "S N"]
    """Which vehicle each one follows; `NOBODY` where it is none of the window."""
    vehicle: Int[Tensor, "S N"]
    """Numbers of the vehicles in the recording."""
    lane: Int[Tensor, "S N"]
    time: Int[Tensor, " S"]
    """Clock of the first state [steps]; recordings of one site share one clock."""
    kind: Shaped[np.ndarray, " S"]
    """What was done to the window, "recorded" where nothing was."""
    dt: float = 0.2

    def __len__(self) -> int:
        return len(self.state)

    def __getitem__(self, rows: Tensor) -> "FollowingWindows":
        if rows.dtype == torch.bool:
            rows = rows.nonzero()[:, 0]
        return replace(
            self,
            **{name: getattr(self, name)[rows] for name in ("state", "leader", "vehicle", "lane", "time")},
            kind=self.kind[rows.numpy()],
        )

    def named(self, kind: str) -> "FollowingWindows":
        """The same windows under another kind."""
        return replace(self, kind=np.full(len(self), kind, object))

    def headways(self) -> Float[Tensor, "S G T"]:
        """Front to front, of the G = N − 1 gaps [m]."""
        return self.state[:, 1:, :, 0] - self.state[:, :-1, :, 0]

    def close(self) -> "FollowingWindows":
        """Only the windows whose headways are in the range `HEADWAY` all along."""
        headway = self.headways()
        return self[((headway >= HEADWAY[0]) & (headway <= HEADWAY[1])).all(-1).all(-1)]


def joined(parts: Sequence[FollowingWindows]) -> FollowingWindows:
    """All windows of the parts, which have the same N and T."""
    fields = ("state", "leader", "vehicle", "lane", "time")
    return replace(
        parts[0],
        **{name: torch.cat([getattr(part, name) for part in parts]) for name in fields},
        kind=np.concatenate([part.kind for part in parts]),
    )


def _without_reaction(windows: FollowingWindows, state: Tensor, kind: str) -> FollowingWindows:
    return replace(windows, state=state, leader=torch.full_like(windows.leader, NOBODY)).named(kind)


def lengthened(windows: FollowingWindows, metres: Float[Tensor, "S G"] | float, kind: str) -> FollowingWindows:
    """Every headway longer by `metres` [m]; speeds stay, so nobody can have reacted at these distances."""
    added = torch.as_tensor(metres, dtype=windows.state.dtype).expand(len(windows), windows.state.shape[1] - 1)
    state = windows.state.clone()
    state[:, 1:, :, 0] += added.cumsum(1)[..., None]
    return _without_reaction(windows, state, kind)


def stretched(windows: FollowingWindows, factor: float) -> FollowingWindows:
    """Every first headway times a factor; speeds stay."""
    first = windows.headways()[..., 0]
    return lengthened(windows, first * (factor - 1), f"headway x {factor:g}")


def at_constant_speed(windows: FollowingWindows, vehicle: int) -> FollowingWindows:
    """One vehicle drives at its mean speed: it reacts to nobody, and nobody has reacted to it.

    Windows in which a headway leaves the range `HEADWAY` are left out.
    """
    state, leader = windows.state.clone(), windows.leader.clone()
    steps = torch.arange(state.shape[2], dtype=state.dtype)
    speed = state[:, vehicle, :, 1].mean(-1, keepdim=True)
    state[:, vehicle, :, 0] = state[:, vehicle, :1, 0] + speed * steps * windows.dt
    state[:, vehicle, :, 1], state[:, vehicle, :, 2] = speed, 0.0
    leader[:, vehicle] = NOBODY
    leader[leader == vehicle] = NOBODY
    return replace(windows, state=state, leader=leader).named(f"vehicle {vehicle} at constant speed").close()


def time_reversed(windows: FollowingWindows) -> FollowingWindows:
    """The film played backwards on a road turned round, so that vehicles drive forwards: effects precede causes."""
    x, v = windows.state[..., :2].flip(2).flip(1).unbind(-1)  # the foremost vehicle is the rearmost now
    x = x.amax((1, 2), keepdim=True) - x
    state = torch.stack([x, v, accelerations(v, windows.dt)], -1)
    windows = replace(windows, vehicle=windows.vehicle.flip(1), lane=windows.lane.flip(1))
    return _without_reaction(windows, state, "time reversed")


def leaders_leader(windows: FollowingWindows) -> FollowingWindows:
    """Vehicles 0 and 2 without the one between them."""
    chosen = [0, 2]
    state = windows.state[:, chosen]
    return replace(
        windows,
        state=state,
        leader=torch.full((len(windows), 2), NOBODY),
        vehicle=windows.vehicle[:, chosen],
        lane=windows.lane[:, chosen],
    ).named("the leader's leader")


def accelerations(v: Float[Tensor, "*B T"], dt: float) -> Float[Tensor, "*B T"]:
    """Acceleration from each state to the next; the last one is repeated [m/s²]."""
    a = (v[..., 1:] - v[..., :-1]) / dt
    return torch.cat([a, a[..., -1:]], -1)


def strangers(windows: FollowingWindows, copies: int = 1) -> FollowingWindows:
    """Vehicles 1 to N−1 replaced by others of equal mean speed, at the same first headways.

    A stranger was recorded at another time than the vehicles behind it, or in another lane; so none of them can react
    to it. Headways stay in the range `HEADWAY` all along. For each window, up to `copies` combinations: the nearest
    strangers by mean speed, the second nearest and so on.
    """
    found = [part for copy in range(copies if len(windows) else 0) if len(part := _strangers(windows, copy))]
    return joined(found) if found else windows[torch.zeros(len(windows), dtype=torch.bool)].named("strangers")


def _strangers(windows: FollowingWindows, copy: int) -> FollowingWindows:
    count, n, steps, _ = windows.state.shape
    mean, rows = windows.state[..., 1].mean(-1), torch.arange(count)
    state, vehicle, lane = windows.state.clone(), windows.vehicle.clone(), windows.lane.clone()
    times, fits = windows.time[:, None].expand(count, n).clone(), torch.ones(count, dtype=torch.bool)
    for place in range(1, n):
        difference = (mean[:, place, None] - mean[None, :, place]).abs()
        near = difference.argsort(dim=1, stable=True)[:, :NEAREST]
        fine = difference.gather(1, near) <= MOST_SPEED_DIFFERENCE
        for other in range(place):  # at another time or in another lane than every vehicle chosen before
            elsewhen = (windows.time[near] - times[:, other, None]).abs() >= steps
            fine &= elsewhen | (windows.lane[near, place] != lane[:, other, None])
            fine &= windows.vehicle[near, place] != vehicle[:, other, None]
        fine &= windows.vehicle[near, place] != windows.vehicle[rows, place, None]
        motion = windows.state[near, place]  # Shape: (S, candidate, T, 3)
        start = state[:, place - 1, 0, 0] + windows.headways()[:, place - 1, 0]
        x = motion[..., 0] - motion[:, :, :1, 0] + start[:, None, None]
        headway = x - state[:, place - 1, None, :, 0]
        fine &= ((headway >= HEADWAY[0]) & (headway <= HEADWAY[1])).all(-1)
        wanted = fine & (fine.cumsum(1) == copy + 1)
        fits &= wanted.any(1)
        chosen = wanted.long().argmax(1)
        state[:, place] = motion[rows, chosen]
        state[:, place, :, 0] = x[rows, chosen]
        vehicle[:, place] = windows.vehicle[near[rows, chosen], place]
        lane[:, place] = windows.lane[near[rows, chosen], place]
        times[:, place] = windows.time[near[rows, chosen]]
    made = _without_reaction(windows, state, "strangers")
    return replace(made, vehicle=vehicle, lane=lane)[fits]


BREAKS: dict[str, Callable[[FollowingWindows], FollowingWindows]] = {
    "headway x 2": lambda known: stretched(known, 2.0),
    "headway x 4": lambda known: stretched(known, 4.0),
    "headway x 15": lambda known: stretched(known, 15.0),
    "headway + 20 m": lambda known: lengthened(known, 20.0, "headway + 20 m"),
    "headway + 60 m": lambda known: lengthened(known, 60.0, "headway + 60 m"),
    "headway + 300 m": lambda known: lengthened(known, 300.0, "headway + 300 m"),
    "vehicle 0 at constant speed": lambda known: at_constant_speed(known, 0),
    "vehicle 1 at constant speed": lambda known: at_constant_speed(known, 1),
    "time reversed": time_reversed,
}
"""The ways to break a window that need no other window."""
