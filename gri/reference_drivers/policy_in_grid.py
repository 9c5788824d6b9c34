"""A policy of the project in the grid of cut-ins: what it sees there, and how its actions drive the ego.

The scene has three vehicles, as the policies expect. Where the policy drives Dubins' car, the ego is the lag vehicle 1
of a merge, the other is vehicle 0 in the lane to its right, and the leader 2 is a phantom 500 m ahead at the ego's
first speed, as with the perturbation `remove_third`. Where it drives along one lane only (1-D point mass), the ego is
vehicle 1, vehicle 0 is a phantom 500 m behind, and vehicle 2 is a phantom 500 m ahead until the other overlaps the ego
sideways; from then on it is the other. Positions are those of front bumpers, and every vehicle counts as
`NOMINAL_LENGTH` long. The policy's action along the road drives the ego; its steering is left out.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gri.core.dynamics import DynamicsName
from gri.core.graph import InteractionGraph
from gri.core.policy import Policy, PolicyState
from gri.core.trajectory import Trajectory
from gri.errors import InputError
from gri.reference_drivers.cut_in_grid import KMH, LANE, LENGTH, RATE, WIDTH, Driven, Grid, OtherCar, drive
from gri.reference_drivers.drivers import Situation

NOMINAL_LENGTH = 5.0  # [m]
PHANTOM = 500.0  # [m]
REINFER = 1.0  # [s] between two inferences of the graph
CHUNK = 2000  # cells that are driven at once
EGO = 1
ChangeGraph = Callable[[InteractionGraph], InteractionGraph]


def drive_policy(policy: Policy, grid: Grid, change_graph: ChangeGraph | None = None) -> Driven:
    """Drive the egos by a policy; its graph is inferred again every `REINFER`, and `change_graph` may replace it.

    Raises:
        InputError: the policy drives other states than Dubins' car or the 1-D point mass, or its period is not a
            multiple of 0.1 s.
    """
    check_policy(policy)
    parts = [grid[slice(first, first + CHUNK)] for first in range(0, len(grid), CHUNK)]
    driven = [drive(part, PolicyControl(policy, part, change_graph)) for part in parts]
    return Driven(np.concatenate([d.collided for d in driven]), np.concatenate([d.slowed for d in driven]))


def check_policy(policy: Policy) -> None:
    """Raise an InputError where a policy cannot drive in the grid."""
    if policy.dynamics.name is DynamicsName.POINT_MASS_2D:
        raise InputError(
            f"policy: got a policy for {policy.dynamics.name} states, the grid of cut-ins wants dubins or"
            " point_mass_1d states; choose another policy"
        )
    steps = policy.dt * RATE
    if steps < 1 - 1e-6 or abs(steps - round(steps)) > 1e-6:
        raise InputError(f"policy: got a policy that acts every {policy.dt:g} s, the grid wants a multiple of 0.1 s")


class PolicyControl:
    """A policy in control of the egos of a grid: called every 0.1 s, it acts once per period of the policy."""

    def __init__(self, policy: Policy, grid: Grid, change_graph: ChangeGraph | None = None) -> None:
        self._policy, self._period, self._step = policy, round(policy.dt * RATE), 0
        self._planar = policy.dynamics.name is DynamicsName.DUBINS
        self._v0, self._x = grid.ego / KMH, np.zeros(len(grid))
        self._a, self._next_a = np.zeros(len(grid)), np.zeros(len(grid))
        self._window = deque(_history(grid, policy, self._planar), policy.history_steps)
        self._memory: PolicyState | None = None
        self._change_graph = change_graph
        self._reinfer = max(round(REINFER / policy.dt), 1)

    @torch.inference_mode()
    def __call__(
        self, now: Situation, live: Bool[np.ndarray, " C"]
    ) -> tuple[Float[np.ndarray, " C"], Bool[np.ndarray, " C"]]:
        """The deceleration of the present period, after which the policy's jerk acts."""
        turn, within = divmod(self._step, self._period)
        if within == 0:
            self._a = np.where(live, self._next_a, 0.0)
            self._next_a = self._a + self._jerk(now, turn) * self._policy.dt
        self._step += 1
        self._x += np.clip(now.v + np.where(live, self._a, 0.0) / RATE, 0.0, self._v0) / RATE
        return -self._a, np.zeros_like(live)

    def _jerk(self, now: Situation, turn: int) -> Float[np.ndarray, " C"]:
        """The policy's jerk [m/s³] for the egos."""
        a = np.where(now.v > 0, self._a, np.maximum(self._a, 0.0))
        state = scene(now, self._x, self._v0, turn * self._policy.dt, a, self._planar)
        self._window.append(state)
        if self._memory is None:
            self._memory = self._infer()
        elif turn % self._reinfer == 0 and self._memory.graph is not None:
            self._memory = replace(self._memory, graph=self._infer().graph)
        action, self._memory = self._policy.act(self._memory, _relative(state[:, :, None], self._x)[:, :, 0])
        jerk = action[:, EGO, 0].numpy().astype(float)
        if not np.isfinite(jerk).all():
            raise InputError("policy: act returned actions that are not finite; correct the policy")
        return jerk

    def _infer(self) -> PolicyState:
        states = _relative(np.stack([*self._window], 2), self._x)
        memory = self._policy.begin(Trajectory.complete(states, self._policy.dt))
        if memory.graph is None or self._change_graph is None:
            return memory
        return replace(memory, graph=self._change_graph(memory.graph))


def scene(
    now: Situation,
    x: Float[np.ndarray, " C"],
    v0: Float[np.ndarray, " C"],
    time: float,
    a: Float[np.ndarray, " C"],
    planar: bool,
) -> Float[np.ndarray, "C 3 D"]:
    """The states of the three vehicles in each cell, y from the centre of the ego's lane.

    `x` [m] is the ego's front bumper, `a` [m/s²] its acceleration. The phantoms drive at `v0` [m/s] since time 0 [s].
    """
    other = x + now.centres - now.lengths / 2 + NOMINAL_LENGTH
    zero, moved = np.zeros_like(x), v0 * time
    if planar:
        heading = np.arctan2(now.approach, np.maximum(now.v_other, 0.1))
        vehicles = [
            [other, now.wandered - LANE, np.hypot(now.v_other, now.approach), heading, zero, zero],
            [x, zero, now.v, zero, a, zero],
            [moved + PHANTOM, zero, v0, zero, zero, zero],
        ]
    else:
        entered = (now.side <= 0) & (now.centres > 0)
        leader = [np.where(entered, other, moved + PHANTOM), np.where(entered, now.v_other, v0), zero]
        vehicles = [[moved - PHANTOM, v0, zero], [x, now.v, a], leader]
    return np.array(vehicles).transpose(2, 0, 1)


def _relative(states: Float[np.ndarray, "C 3 T D"], x: Float[np.ndarray, " C"]) -> Float[Tensor, "C 3 T D"]:
    """float32 states with positions counted from x [m], where float32 is finest."""
    counted = states.copy()
    counted[..., 0] -= x[:, None, None]
    return torch.from_numpy(counted.astype(np.float32))


def _history(grid: Grid, policy: Policy, planar: bool) -> list[Float[np.ndarray, "C 3 D"]]:
    """The states before the first step, at constant speeds and without lateral motion."""
    path, cells = OtherCar.of(grid), len(grid)
    v, v_other, zero = grid.ego / KMH, grid.other / KMH, np.zeros(cells)
    centres = path.along[0] + v * (path.ramp - path.start) / RATE
    found = []
    for k in range(policy.history_steps - 1, 0, -1):
        before = k * policy.dt
        earlier = centres + (v - v_other) * before
        now = Situation(
            centres=earlier,
            gap=np.abs(earlier) - LENGTH,
            side=path.across[0] - WIDTH,
            lengths=np.full(cells, 2 * LENGTH),
            v=v,
            v_other=v_other,
            approach=zero,
            wandered=LANE - path.across[0],
            a=zero,
        )
        found.append(scene(now, -v * before, v, -before, zero, planar))
    return found
