"""Reward features of recorded traffic, with networks for what a driver wants to keep (Sec. VI-D).

    f_v = (v_j − h1)²,   g_v = (v_j − h2(x_i, x_j))²,   g_s = ReLU(h3(x_i, x_j) − (x_i − x_j))²,
    g_spatial = ReLU(h_d(x_i, x_j) − d_j)²,   g_time = ReLU(h_T(x_i, x_j) − (T_j − T_i))²

d_j is the distance along the road to the point of collision, where the straight lines of the two vehicles meet, and
T = d / v the time to it. Two signs are not those printed: g_spatial = ReLU((x_j − x_poc) − h)² costs nothing before the
point of collision, and g_time = ReLU(h − (T_i − T_j))² would have whoever yields arrive first; `printed_yield` has
them. Lines of vehicles in one lane do not meet, so that nothing would hold whoever has merged back from the vehicle
that it yielded to: they meet where the one ahead is (`overlap`).

What the networks read is less than the paper's x_i, x_j: a reference for v_j that reads v_j can equal it, and the term
says nothing any more. So h1 is one number, h2 reads the headway and v_i, h3 the two speeds. Outputs are softplus, a
ReLU that cannot die.

What makes one graph likelier than another is said by two rules, which the networks refine. Nobody heeding anyone would
drive at the free speed, h1, which is far above that of dense traffic. Whoever follows wants the speed of the vehicle
ahead and a headway that grows with it, h2 = v_i + κ·(x_i − x_j − s − T·v_i), so that a vehicle two ahead, at twice the
headway, is not what it follows. Networks alone find a likelihood as high in which h2 is near 0 and does no more than
hold h1 back; then it hardly matters who is followed.
"""

from math import inf

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import softplus

from gri.core.layers import mlp

Value = Float[Tensor, "*batch"]


class References(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Size of the reference networks, where they begin, and the range of the point of collision."""

    hidden: int = 16
    speed: float = 29.0
    """h1 before training, the 65 mph posted on California freeways [m/s]."""
    headway: float = 6.0
    """h3 of standing vehicles before training, and s of h2 [m]."""
    time_headway: float = 1.3
    """By how much h3 grows with v_j before training, and T of h2: the mean of IDM drivers on US-101 [s]."""
    closing: float = 0.2
    """κ before training [1/s]."""
    correction: float = 1.0
    """What the network may add to h2, or take away from it [m/s]."""
    catch_up: float | None = None
    """How much faster than the vehicle ahead whoever follows wants to be to close a surplus headway, but for the
    network [m/s]; None: any. Into the headway between two vehicles of a lane a third may have come.
    """
    distance: float = 10.0
    """h_d before training [m]."""
    time: float = 1.0
    """h_T before training [s]."""
    speed_unit: float = 5.0
    """Of what networks read and answer [m/s]."""
    length_unit: float = 15.0
    """The same [m]."""
    time_unit: float = 1.0
    """The same [s]."""
    collision_range: float = 100.0
    """A point of collision farther ahead is no concern [m]."""
    overlap: float = 2.0
    """Vehicles less far apart across the road, the width of a car, meet where the one ahead is [m]; 0: as printed."""
    slowest: float = 1.0
    """Speeds count as at least this in times to collision [m/s]."""
    printed_yield: bool = False


class ReferenceNetworks(nn.Module):
    """h1, h2, h3, and for yielding h_d and h_T; inputs are plain values, leading axes are free."""

    def __init__(self, config: References, yielding: bool = False) -> None:
        super().__init__()
        self.config = config
        self.h1 = nn.Parameter(_before(config.speed / config.speed_unit))
        self.kappa = nn.Parameter(_before(config.closing))
        self.h2 = mlp([2, config.hidden, config.hidden, 1], last_scale=0.1)
        self.h3 = mlp([2, config.hidden, config.hidden, 1], last_scale=0.1)
        if yielding:
            self.h_d = mlp([2, config.hidden, config.hidden, 1], last_scale=0.1)
            self.h_t = mlp([2, config.hidden, config.hidden, 1], last_scale=0.1)

    def own_speed(self) -> Float[Tensor, ""]:
        """h1 [m/s]."""
        return softplus(self.h1) * self.config.speed_unit

    def speed(self, headway: Value, sender_speed: Value) -> Value:
        """h2 [m/s]."""
        c = self.config
        surplus = headway - c.headway - c.time_headway * sender_speed
        added = _answer(self.h2, (headway / c.length_unit).clamp(-2, 4), sender_speed / c.speed_unit).tanh()
        closing = (softplus(self.kappa) * surplus).clamp(max=inf if c.catch_up is None else c.catch_up)
        wanted = sender_speed + closing + c.correction * added
        return softplus(wanted / c.speed_unit) * c.speed_unit

    def headway(self, sender_speed: Value, receiver_speed: Value) -> Value:
        """h3 [m]."""
        c = self.config
        begun = (c.headway + c.time_headway * receiver_speed) / c.length_unit
        return softplus(begun + self._by_speeds(self.h3, sender_speed, receiver_speed)) * c.length_unit

    def distance(self, sender_speed: Value, receiver_speed: Value) -> Value:
        """h_d [m]."""
        c = self.config
        begun = _before(c.distance / c.length_unit)
        return softplus(begun + self._by_speeds(self.h_d, sender_speed, receiver_speed)) * c.length_unit

    def time(self, sender_speed: Value, receiver_speed: Value) -> Value:
        """h_T [s]."""
        c = self.config
        begun = _before(c.time / c.time_unit)
        return softplus(begun + self._by_speeds(self.h_t, sender_speed, receiver_speed)) * c.time_unit

    def _by_speeds(self, network: nn.Sequential, sender: Value, receiver: Value) -> Value:
        return _answer(network, sender / self.config.speed_unit, receiver / self.config.speed_unit)


def _before(value: float) -> Tensor:
    """The number that softplus turns into this one."""
    return torch.tensor(value).expm1().log()


def _answer(network: nn.Sequential, *inputs: Value) -> Value:
    return network(torch.stack(torch.broadcast_tensors(*inputs), -1))[..., 0]


def collision_point(
    sender: Float[Tensor, "*batch 4"], receiver: Float[Tensor, "*batch 4"], farthest: float, overlap: float
) -> tuple[Value, Float[Tensor, "*batch"]]:
    """x of the point where two vehicles [x, y, vx, vy] would meet if both went straight on; 1 if it counts, else 0.

    It counts if it is ahead of both vehicles, by no more than `farthest` [m]. Less than `overlap` [m] apart across the
    road they would meet where the sender is, which counts if it is ahead of the receiver.
    """
    dx, dy = sender[..., 0] - receiver[..., 0], sender[..., 1] - receiver[..., 1]
    (vx_i, vy_i), (vx_j, vy_j) = sender[..., 2:].unbind(-1), receiver[..., 2:].unbind(-1)
    cross = vx_j * vy_i - vy_j * vx_i
    parallel = cross.abs() < 1e-3
    time = (dx * vy_i - dy * vx_i) / torch.where(parallel, torch.ones_like(cross), cross)  # of the receiver [s]
    in_line = dy.abs() < overlap
    place = torch.where(in_line, sender[..., 0], receiver[..., 0] + vx_j * time)
    ahead_i, ahead_j = place - sender[..., 0], place - receiver[..., 0]
    ahead = (ahead_j > 0) & (in_line | ~parallel & (ahead_i > 0))
    counts = ahead & (ahead_i < farthest) & (ahead_j < farthest)
    return torch.where(counts, place, receiver[..., 0]), counts.to(place.dtype)


def g_spatial(x_poc: Value, counts: Value, receiver: Float[Tensor, "*batch 4"], wanted: Value, printed: bool) -> Value:
    """ReLU(h_d − d_j)²  [m²]: whoever yields keeps away from the point of collision."""
    distance = x_poc - receiver[..., 0]
    short = -distance - wanted if printed else wanted - distance
    return counts * short.clamp(min=0) ** 2


def g_time(
    x_poc: Value,
    counts: Value,
    sender: Float[Tensor, "*batch 4"],
    receiver: Float[Tensor, "*batch 4"],
    wanted: Value,
    references: References,
) -> Value:
    """ReLU(h_T − (T_j − T_i))²  [s²]: whoever yields arrives later."""
    at = [(x_poc - s[..., 0]) / s[..., 2].clamp(min=references.slowest) for s in (sender, receiver)]
    later = at[0] - at[1] if references.printed_yield else at[1] - at[0]
    return counts * (wanted - later).clamp(min=0) ** 2
