"""A policy at the wheel of several groups: world states in, one model call, commands out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from cosim.episode import COLUMNS
from cosim.frames import RoadFrame, model_offsets
from cosim.groups import Group
from cosim.sumo import Snapshot, Sumo
from gri.dynamics import DynamicsName, stop_at_standstill
from gri.graph import InteractionGraph
from gri.policy import Policy
from gri.types import Trajectory

OWNED = (0, 1)  # roles that a policy drives; 2 is the given leader
_SVA = [COLUMNS.index(name) for name in ("s", "v", "a")]


@dataclass(frozen=True)
class Frame:
    """The groups at one instant: features of COLUMNS, who is there, and their rows in the snapshot (0 where absent)."""

    time: float
    state: Float[np.ndarray, "G 3 C"]
    valid: Bool[np.ndarray, "G 3"]
    rows: Int[np.ndarray, "G 3"]

    @classmethod
    def of(cls, snapshot: Snapshot, groups: Sequence[Group]) -> "Frame":
        """The groups' part of a snapshot; absent vehicles have zeros."""
        where = {vehicle: row for row, vehicle in enumerate(snapshot.ids)}
        found = np.array([[where.get(vehicle, -1) for vehicle in group.ids] for group in groups])
        rows, valid = found.clip(min=0), found >= 0
        features = {"x": snapshot.xy[:, 0], "y": snapshot.xy[:, 1]}
        columns = [features[name] if name in features else getattr(snapshot, name) for name in COLUMNS]
        state = np.stack([column[rows] for column in columns], axis=-1)
        return cls(snapshot.time, np.where(valid[..., None], state, 0.0), valid, rows)

    def carried_on(self, previous: "Frame") -> "Frame":
        """With the last known state of vehicles that are gone; `valid` keeps saying that they are."""
        return replace(self, state=np.where(self.valid[..., None], self.state, previous.state))


class Pilot:
    """The model-frame state of all groups of a round and the policy's memory of them."""

    def __init__(self, policy: Policy, history: Sequence[Frame], length: Float[np.ndarray, "G 3"], dt: float) -> None:
        assert policy.dynamics.name is DynamicsName.POINT_MASS_1D, f"cannot drive {policy.dynamics.name} here"
        self._policy, self._dt = policy, dt
        self._offset = torch.from_numpy(model_offsets(length))
        self._lateral = history[-1].state[:, OWNED, COLUMNS.index("d")]
        states = torch.stack([self._model_state(frame) for frame in history[-policy.history_steps :]], dim=2)
        self._state = self._commanded = states[:, :, -1]
        with torch.inference_mode():
            self._memory = policy.begin(Trajectory.complete(_relative(states), dt))

    @property
    def graph(self) -> InteractionGraph | None:
        """What the policy believes, for all groups."""
        return self._memory.graph

    @property
    def expected(self) -> Float[np.ndarray, "G 2 3"]:
        """(s, v, a) of the owned vehicles after the last command."""
        commanded = self._commanded[:, OWNED].numpy().copy()
        commanded[..., 0] -= self._offset[:, OWNED].numpy()
        return commanded

    def command(self, world: Sumo, road: RoadFrame, groups: Sequence[Group], active: Sequence[int]) -> None:
        """Ask the policy, move the dynamics one step on, and tell SUMO where the vehicles will be."""
        with torch.inference_mode():
            action, self._memory = self._policy.act(self._memory, _relative(self._state))
            following = self._policy.dynamics.step(self._state, action.double(), self._dt)
            self._commanded = stop_at_standstill(self._state, following)
        s, v, _ = np.moveaxis(self.expected, -1, 0)
        xy, heading = road.to_world(s.ravel(), self._lateral.ravel())
        poses = np.column_stack([xy, heading, v.ravel()]).reshape(*s.shape, 4).tolist()
        for g in active:
            for role in OWNED:
                world.command(groups[g].ids[role], *poses[g][role])

    def observe(self, frame: Frame, active: Sequence[int]) -> None:
        """Read the world; the vehicles that are driven are where the dynamics put them."""
        state = self._model_state(frame)
        state[_owned(active)] = self._commanded[_owned(active)]
        self._state = state

    def stamp(self, frame: Frame, active: Sequence[int]) -> Frame:
        """The frame with the dynamics' acceleration of owned vehicles; SUMO reports the past step's mean instead."""
        state = frame.state.copy()
        state[(*_owned(active), COLUMNS.index("a"))] = self._commanded[_owned(active)][..., 2].numpy()
        return replace(frame, state=state)

    def _model_state(self, frame: Frame) -> Float[Tensor, "G 3 3"]:
        """(x, v, a) in the model's frame, float64."""
        state = torch.from_numpy(frame.state[..., _SVA].copy())
        state[..., 0] += self._offset
        return state


def _owned(active: Sequence[int]) -> tuple[np.ndarray, ...]:
    """Index of the owned vehicles of the active groups in a [G, 3, ...] array."""
    return np.ix_(np.array(active, dtype=int), np.array(OWNED))


def _relative(state: Float[Tensor, "G 3 *T 3"]) -> Float[Tensor, "G 3 *T 3"]:
    """float32 states with x counted from the leader's latest position, where float32 is finest."""
    latest = state[:, 2:3, ..., 0] if state.dim() == 3 else state[:, 2:3, -1:, 0]
    return torch.cat([state[..., :1] - latest[..., None], state[..., 1:]], dim=-1).float()
