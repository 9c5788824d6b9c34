"""Reward features of recorded traffic, with learned reference networks h for desired values (Sec. VI-D).

    f_v = (v_j − h1)²                              g_v = (v_j − h2(x_i, x_j))²
    g_s = ReLU(h3(x_i, x_j) − (x_i − x_j))²        g_spatial = ReLU(h_d(x_i, x_j) − d_j)²
    g_time = ReLU(h_T(x_i, x_j) − (T_j − T_i))²

`gri.rewards.terms.naturalistic_terms` has f_v, g_v and g_s; this file has the networks, g_spatial and g_time. The
straight paths of two vehicles cross at the point of collision (POC). d_j is the distance of the receiver to it along
the road, and T = d / v is the time to it.

Two signs differ from the paper. The printed g_spatial = ReLU((x_j − x_poc) − h)² is 0 before the point of collision.
The printed g_time = ReLU(h − (T_i − T_j))² would make the yielding vehicle arrive first. `printed_yield` selects the
printed forms. Paths of two vehicles in one lane do not cross; the point of collision is then the position of the
vehicle ahead (`overlap`, docs/decisions/015-yielding-in-lane.md). Without this, a vehicle that has merged would lose
its reason to stay behind.

The networks read less than x_i and x_j. A reference for v_j that reads v_j could equal v_j, and the term would be 0
everywhere. So h1 is one number, h2 reads the headway and v_i, and h3, h_d and h_T read the two speeds. The output
function is softplus; the paper's ReLU could get stuck at 0.

Two rules give the edges their meaning, and the networks refine them. A vehicle without an edge drives at the free speed
h1, which is far above the speed of dense traffic. A follower drives at the speed of its leader and closes a surplus
headway: h2 = v_i + κ·(x_i − x_j − s − T·v_i). So a vehicle two ahead, at twice the headway, does not explain the
follower. Networks without these rules reach the same likelihood with h2 near 0, and then the graph hardly matters.
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
    """Size and initial values of the reference networks, and constants of the point of collision."""

    hidden: int = 16
    """Units per hidden layer."""
    speed: float = 29.0
    """h1 before training [m/s]: the speed limit of California freeways, 65 mph."""
    headway: float = 6.0
    """h3 before training at standstill, and s in h2 [m]."""
    time_headway: float = 1.3
    """Slope of h3 in v_j before training, and T in h2 [s]: the mean of IDM drivers fitted to US-101."""
    closing: float = 0.2
    """κ before training [1/s]."""
    correction: float = 1.0
    """Largest change of h2 by its network, up or down [m/s]."""
    catch_up: float | None = None
    """Largest excess of h2 over the speed of the leader, before the network's change [m/s]; None: no limit.

    It matters when a third vehicle merges between two vehicles of a lane, and the headway to the leader is large.
    """
    distance: float = 10.0
    """h_d before training [m]."""
    time: float = 1.0
    """h_T before training [s]."""
    speed_unit: float = 5.0
    """Unit of speeds in the inputs and outputs of the networks [m/s]."""
    length_unit: float = 15.0
    """Unit of lengths in the inputs and outputs of the networks [m]."""
    time_unit: float = 1.0
    """Unit of times in the outputs of the networks [s]."""
    collision_range: float = 100.0
    """Points of collision farther ahead than this are ignored [m]."""
    overlap: float = 2.0
    """Vehicles with a smaller lateral distance are in line [m], about the width of a car; 0: never, as printed."""
    slowest: float = 1.0
    """Least speed in times to collision [m/s]."""
    printed_yield: bool = False
    """Use g_spatial and g_time with the signs printed in the paper."""


class ReferenceNetworks(nn.Module):
    """h1, h2 and h3; with `yielding` also h_d and h_T. Inputs and outputs are in SI units; leading axes are free."""

    def __init__(self, config: References, yielding: bool = False) -> None:
        super().__init__()
        self.config = config
        self.h1 = nn.Parameter(_inverse_softplus(config.speed / config.speed_unit))
        self.kappa = nn.Parameter(_inverse_softplus(config.closing))
        self.h2 = mlp([2, config.hidden, config.hidden, 1], last_scale=0.1)
        self.h3 = mlp([2, config.hidden, config.hidden, 1], last_scale=0.1)
        if yielding:
            self.h_d = mlp([2, config.hidden, config.hidden, 1], last_scale=0.1)
            self.h_t = mlp([2, config.hidden, config.hidden, 1], last_scale=0.1)

    def own_speed(self) -> Float[Tensor, ""]:
        """h1, the free speed [m/s]."""
        return softplus(self.h1) * self.config.speed_unit

    def speed(self, headway: Value, sender_speed: Value) -> Value:
        """h2, the desired speed of a follower [m/s], from its headway [m] and the speed of its leader [m/s]."""
        c = self.config
        surplus = headway - c.headway - c.time_headway * sender_speed
        change = _evaluate(self.h2, (headway / c.length_unit).clamp(-2, 4), sender_speed / c.speed_unit).tanh()
        closing = (softplus(self.kappa) * surplus).clamp(max=inf if c.catch_up is None else c.catch_up)
        desired = sender_speed + closing + c.correction * change
        return softplus(desired / c.speed_unit) * c.speed_unit

    def headway(self, sender_speed: Value, receiver_speed: Value) -> Value:
        """h3, the least desired headway of a follower [m]."""
        c = self.config
        initial = (c.headway + c.time_headway * receiver_speed) / c.length_unit
        return softplus(initial + self._by_speeds(self.h3, sender_speed, receiver_speed)) * c.length_unit

    def distance(self, sender_speed: Value, receiver_speed: Value) -> Value:
        """h_d, the desired distance of a yielding vehicle to the point of collision [m]."""
        c = self.config
        initial = _inverse_softplus(c.distance / c.length_unit)
        return softplus(initial + self._by_speeds(self.h_d, sender_speed, receiver_speed)) * c.length_unit

    def time(self, sender_speed: Value, receiver_speed: Value) -> Value:
        """h_T, the desired delay of a yielding vehicle at the point of collision [s]."""
        c = self.config
        initial = _inverse_softplus(c.time / c.time_unit)
        return softplus(initial + self._by_speeds(self.h_t, sender_speed, receiver_speed)) * c.time_unit

    def _by_speeds(self, network: nn.Sequential, sender: Value, receiver: Value) -> Value:
        return _evaluate(network, sender / self.config.speed_unit, receiver / self.config.speed_unit)


def _inverse_softplus(value: float) -> Tensor:
    """The number whose softplus is `value`."""
    return torch.tensor(value).expm1().log()


def _evaluate(network: nn.Sequential, *inputs: Value) -> Value:
    return network(torch.stack(torch.broadcast_tensors(*inputs), -1))[..., 0]


def collision_point(
    sender: Float[Tensor, "*batch 4"], receiver: Float[Tensor, "*batch 4"], farthest: float, overlap: float
) -> tuple[Value, Float[Tensor, "*batch"]]:
    """x of the point of collision [m] of vehicles [x, y, vx, vy], and 1 where it counts, else 0.

    It is the point where the straight paths of the two vehicles cross. It counts if it is ahead of both vehicles, by
    less than `farthest` [m]. If the lateral distance is below `overlap` [m], it is the position of the sender, and
    counts if the sender is ahead of the receiver. Where it does not count, x is that of the receiver.
    """
    dx, dy = sender[..., 0] - receiver[..., 0], sender[..., 1] - receiver[..., 1]
    (vx_i, vy_i), (vx_j, vy_j) = sender[..., 2:].unbind(-1), receiver[..., 2:].unbind(-1)
    cross = vx_j * vy_i - vy_j * vx_i
    parallel = cross.abs() < 1e-3
    time = (dx * vy_i - dy * vx_i) / torch.where(
        parallel, torch.ones_like(cross), cross
    )  # until the receiver is there [s]
    in_line = dy.abs() < overlap
    x_poc = torch.where(in_line, sender[..., 0], receiver[..., 0] + vx_j * time)
    d_i, d_j = x_poc - sender[..., 0], x_poc - receiver[..., 0]
    ahead = (d_j > 0) & (in_line | ~parallel & (d_i > 0))
    counts = ahead & (d_i < farthest) & (d_j < farthest)
    return torch.where(counts, x_poc, receiver[..., 0]), counts.to(x_poc.dtype)


def g_spatial(x_poc: Value, counts: Value, receiver: Float[Tensor, "*batch 4"], desired: Value, printed: bool) -> Value:
    """g_spatial = ReLU(h_d − d_j)²  [m²]: a yielding vehicle is too close to the point of collision.

    `desired` is h_d [m], and `counts` is 1 where the point of collision counts, else 0.
    """
    distance = x_poc - receiver[..., 0]
    short = -distance - desired if printed else desired - distance
    return counts * short.clamp(min=0) ** 2


def g_time(
    x_poc: Value,
    counts: Value,
    sender: Float[Tensor, "*batch 4"],
    receiver: Float[Tensor, "*batch 4"],
    desired: Value,
    references: References,
) -> Value:
    """g_time = ReLU(h_T − (T_j − T_i))²  [s²]: a yielding vehicle reaches the point of collision too early.

    `desired` is h_T [s], and `counts` is 1 where the point of collision counts, else 0.
    """
    t_i, t_j = ((x_poc - s[..., 0]) / s[..., 2].clamp(min=references.slowest) for s in (sender, receiver))
    delay = t_i - t_j if references.printed_yield else t_j - t_i
    return counts * (desired - delay).clamp(min=0) ** 2
