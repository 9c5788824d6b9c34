"""Car-following scenes whose drivers do not maximise a reward: the intelligent driver model (Treiber et al. 2000).

    a* = a·[1 − (v/v0)⁴ − (s*/s)²],   s* = s0 + max(0, v·T + v·Δv / (2√(ab))),   jerk = (a* − a_now) / τ

Every driver has constants of its own and an actuator with a lag τ. A driver without an edge drives towards its wished
speed; with several edges it takes the lowest of the accelerations. Nothing here is shared with the rewards or with a
policy network: the learner meets drivers of another class.
"""

import msgspec
import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri.core.dynamics import POINT_MASS_1D, stop_at_standstill
from gri.core.graph import FOLLOWING, pairs
from gri.core.scenes import Scenes
from gri.data.ranges.leader import uniform


class IdmExpert(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="idm"):
    """Ranges of the constants, drawn uniformly for each driver. Gaps are headways from front to front.

    The defaults suit the paper's scenes: 4 to 6 m/s at headways of 4 to 8 m.
    """

    wished_speed: tuple[float, float] = (6.0, 8.0)
    """v0 [m/s]."""
    time_headway: tuple[float, float] = (0.6, 1.0)
    """T [s]."""
    standstill: tuple[float, float] = (1.0, 2.0)
    """s0 [m]."""
    acceleration: tuple[float, float] = (1.0, 2.0)
    """a [m/s²]."""
    deceleration: tuple[float, float] = (1.5, 3.0)
    """b, the comfortable deceleration [m/s²]."""
    lag: tuple[float, float] = (0.3, 0.6)
    """τ, the time in which the acceleration follows the wanted one [s]."""


LEAST_GAP = 0.5
"""Gap below which the formula does not grow [m]. A driver that is ahead of its leader has this gap."""
HARDEST_BRAKING = -6.0  # [m/s²]


def drive(
    expert: IdmExpert,
    start: Float[Tensor, "B 3 3"],
    leader: Float[Tensor, "B T 3"],
    graph: Int[Tensor, "B E"],
    dt: float,
    noise: float,
    generator: torch.Generator,
) -> Scenes:
    """Scenes of IDM drivers; the last vehicle is the leader. `noise` is the standard deviation of the jerk's [m/s³]."""
    drivers = {name: uniform(generator, *getattr(expert, name), len(start), 2) for name in IdmExpert.__struct_fields__}
    follows = torch.zeros(len(start), 3, 2, dtype=torch.bool)  # Shape: (B, sender, receiver)
    for edge, (i, j) in enumerate(pairs(3)):
        if j < 2:
            follows[:, i, j] = graph[:, edge] == FOLLOWING.index("follow")
    states, actions = [start], []
    for t in range(leader.shape[1] - 1):
        now = states[-1]
        jerk = (wanted_acceleration(drivers, now, follows) - now[:, :2, 2]) / drivers["lag"]
        jerk = jerk + noise * torch.randn(jerk.shape, generator=generator)
        moved = POINT_MASS_1D.step(now[:, :2], jerk[..., None], dt)
        states.append(torch.cat([stop_at_standstill(now[:, :2], moved), leader[:, t + 1 : t + 2]], 1))
        actions.append(jerk[..., None])
    return Scenes(torch.stack(states, 2), torch.stack(actions, 2), graph)


def wanted_acceleration(
    drivers: dict[str, Float[Tensor, "B 2"]], state: Float[Tensor, "B 3 3"], follows: Tensor
) -> Float[Tensor, "B 2"]:
    """a* of the two driven vehicles [m/s²]."""
    x, v = state[..., 0], state[..., 1]
    own = v[:, None, :2]
    gap = (x[:, :, None] - x[:, None, :2]).clamp(min=LEAST_GAP)
    comfort = 2 * (drivers["acceleration"] * drivers["deceleration"]).sqrt()[:, None]
    dynamic = own * drivers["time_headway"][:, None] + own * (own - v[:, :, None]) / comfort
    ratio = (drivers["standstill"][:, None] + dynamic.clamp(min=0)) / gap
    braking = torch.where(follows, ratio.square(), torch.zeros_like(ratio)).amax(1)
    free = 1 - (v[:, :2] / drivers["wished_speed"]) ** 4
    return (drivers["acceleration"] * (free - braking)).clamp(min=HARDEST_BRAKING)
