"""Motion of the vehicles of a merge, as the explanations need it: gaps, speeds, accelerations and lanes."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

NOMINAL_LENGTH = 5.0  # [m], of vehicles whose length is not known
STRAIGHTEST = 1.875  # greatest lateral speed of a path of least jerk, in widths per duration
LEAST_CHANGE = 1.0  # [m] sideways, of a lane change
SLOWEST_CHANGE = 0.03  # widths per step
BEGUN = 0.002  # widths from the centre of its lane, from which a vehicle may be changing lanes if others do not waver
WAVERS = 4.0  # standard deviations of how other vehicles waver; further from its centre a vehicle may be changing lanes
REST = 3  # steps before a change begins, in which a vehicle is not further from the centre than that


@dataclass(frozen=True)
class MergeMotion:
    """N vehicles over T steps. Vehicle 0 may change lanes; the last one shows which lane has number 0."""

    x: Float[Tensor, "S N T"]
    """Positions of the front bumpers along the road [m]."""
    v: Float[Tensor, "S N T"]
    a: Float[Tensor, "S N T"]
    """Accelerations from each step to the next [m/s²]; the last step repeats the one before and is not judged."""
    lane: Float[Tensor, "S N T"]
    """Numbers of the lanes. A vehicle is in its new lane from the step on in which its lane change begins."""
    length: Float[Tensor, "S N"]
    dt: float

    def __len__(self) -> int:
        return len(self.x)

    def __getitem__(self, scenes: slice | Tensor) -> "MergeMotion":
        return MergeMotion(
            self.x[scenes], self.v[scenes], self.a[scenes], self.lane[scenes], self.length[scenes], self.dt
        )

    def gap(self, behind: int, ahead: int) -> Float[Tensor, "S T"]:
        """From the front of one vehicle to the rear of another [m]; negative where they overlap or change places."""
        return self.x[:, ahead] - self.x[:, behind] - self.length[:, ahead, None]

    def same_lane(self, i: int, j: int) -> Bool[Tensor, "S T"]:
        """Whether two vehicles are in one lane."""
        return self.lane[:, i] == self.lane[:, j]

    def next_to_each_other(self, i: int, j: int) -> Bool[Tensor, "S T"]:
        """Whether no third vehicle in j's lane is between i and j along the road."""
        free = torch.ones_like(self.x[:, i], dtype=torch.bool)
        low, high = torch.minimum(self.x[:, i], self.x[:, j]), torch.maximum(self.x[:, i], self.x[:, j])
        for m in range(self.x.shape[1]):
            if m not in (i, j):
                free &= ~(self.same_lane(m, j) & (self.x[:, m] > low) & (self.x[:, m] < high))
        return free


def motion_of(
    state: Float[Tensor, "S N T D"],
    lane_width: float | Float[Tensor, " S"],
    dt: float,
    length: Float[Tensor, "S N"] | None = None,
    unfinished: bool = False,
) -> MergeMotion:
    """The motion in states whose first features are x, y and v [m, m/s].

    Args:
        lane_width: distance between the centres of two lanes [m].
        length: of the vehicles [m]; 0 where not known.
        unfinished: whether a vehicle on its way to the line in the last step is taken to change lanes.

    Raises:
        ValueError: numbers that are not finite, or fewer than three steps.
    """
    if not bool(torch.isfinite(state[..., :3]).all()):
        raise ValueError(
            "got positions or speeds that are not finite; leave out vehicles that were not seen throughout"
        )
    if state.shape[2] < 3:
        raise ValueError(f"got {state.shape[2]} steps, wanted at least 3; give a longer history")
    x, y, v = state[..., 0].double(), state[..., 1].double(), state[..., 2].double()
    a = (v[..., 1:] - v[..., :-1]) / dt
    known = torch.zeros_like(x[..., 0]) if length is None else length.double()
    return MergeMotion(
        x=x,
        v=v,
        a=torch.cat([a, a[..., -1:]], -1),
        lane=lane_numbers(y, lane_width, unfinished),
        length=torch.where(known > 0, known, NOMINAL_LENGTH),
        dt=dt,
    )


def lane_width_of(state: Float[Tensor, "S N T D"]) -> float:
    """The distance between two lanes [m]: the median way sideways of the vehicles 0 that change lanes.

    Raises `ValueError` if none does.
    """
    sideways = (state[:, 0, -1, 1] - state[:, 0, 0, 1]).abs().double()
    if not bool((sideways > LEAST_CHANGE).any()):
        raise ValueError(
            f"got no scene in which vehicle 0 moves more than {LEAST_CHANGE:g} m sideways, wanted lane changes"
        )
    return float(sideways[sideways > LEAST_CHANGE].median())


def lane_numbers(
    y: Float[Tensor, "S N T"], lane_width: float | Float[Tensor, " S"], unfinished: bool = False
) -> Float[Tensor, "S N T"]:
    """Numbers of the lanes, counted to the left from the last vehicle's first lane.

    A lane change is taken for a path of least jerk: it begins half its duration before the line is crossed, and the
    duration is 1.875 widths over the greatest lateral speed. So the beginning is found without a threshold on small
    lateral movements, also in noise. An `unfinished` one has not reached the line in the last step: then the place and
    the speed there say where on such a path a vehicle is.
    """
    width = torch.as_tensor(lane_width, dtype=y.dtype)
    across = (y - y[:, -1:, :1]) / (width[:, None, None] if width.ndim else width)
    lane = across.round()
    for scene, vehicle, t in torch.nonzero(lane[..., 1:] != lane[..., :-1]).tolist():
        path = across[scene, vehicle]
        line = (path[t].round() + path[t + 1].round()) / 2
        crossing = t + float((line - path[t]) / (path[t + 1] - path[t]))
        near = path[max(t - 3, 0) : t + 5]
        speed = max(float((near[1:] - near[:-1]).abs().max()), SLOWEST_CHANGE)
        begin = round(crossing - STRAIGHTEST / speed / 2)
        lane[scene, vehicle, max(begin + 1, 0) : t + 1] = path[t + 1].round()
    return _with_changes_begun(lane, across) if unfinished else lane


def _with_changes_begun(lane: Float[Tensor, "S N T"], across: Float[Tensor, "S N T"]) -> Float[Tensor, "S N T"]:
    """The lanes with those changes that have begun in the last step but have not reached the line.

    On a path of least jerk over the duration D, s = 10u³ − 15u⁴ + 6u⁵ widths are behind after the share u of it. So the
    last two steps give two shares, 1/D apart. A vehicle must be further from the centre of its lane than others waver,
    and it must have been nearer before it began.
    """
    u = torch.linspace(0, 0.5, 2001, dtype=across.dtype)
    done = 10 * u**3 - 15 * u**4 + 6 * u**5
    offset = across[..., -2:] - lane[..., -1:]
    now, before = offset[..., 1], offset[..., 0] * offset[..., 1].sign()
    share, last = (
        u[torch.searchsorted(done, s.clamp(min=0).contiguous()).clamp(max=len(u) - 1)] for s in (now.abs(), before)
    )
    duration = 1 / (share - last).clamp(min=1e-9)
    wavers = (WAVERS * _wavering(lane, across)).clamp(min=BEGUN)
    begun = (now.abs() > wavers) & (now.abs() > before) & (duration < STRAIGHTEST / SLOWEST_CHANGE)
    for scene, vehicle in torch.nonzero(begun).tolist():
        ago = max(int((share * duration)[scene, vehicle].round()), 1)
        first = max(lane.shape[-1] - ago, 0)
        rest = slice(max(first - 1 - REST, 0), max(first - 1, 0))
        if bool(((across - lane)[scene, vehicle, rest].abs() <= wavers[scene, vehicle]).all()):
            lane[scene, vehicle, first:] += now[scene, vehicle].sign()
    return lane


def _wavering(lane: Float[Tensor, "S N T"], across: Float[Tensor, "S N T"]) -> Float[Tensor, "S N"]:
    """How the other vehicles waver in their lanes [widths]: the standard deviation of the one that does so least.

    So one other vehicle may be changing lanes itself.
    """
    sd = (across - lane).std(-1)
    itself = torch.eye(sd.shape[1], dtype=torch.bool)
    return sd[:, None].expand(-1, sd.shape[1], -1).masked_fill(itself, torch.inf).amin(-1)
