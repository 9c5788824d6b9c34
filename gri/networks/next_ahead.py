"""A relational policy that also follows whoever is next ahead in its lane, in its group or not.

The graph says to whom a vehicle reacts, and a policy knows nobody else. So a lag vehicle that yields to a merging one
does not see the leader before it, and nobody sees a vehicle of the surrounding traffic. Here every vehicle also asks
what it has learned of following: it is vehicle 0 of a scene of two, whose other vehicle is the next one ahead. The more
careful of both answers counts along the road; across it the graph decides alone, up to the lane that a vehicle merges
into: faster than it was taught, a policy would swing through that lane and into the one behind it.
"""

from collections.abc import Iterable

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gri.core.dynamics import Dynamics
from gri.core.graph import EdgeType, InteractionGraph
from gri.core.nearby import OWN_WIDTH, Nearby, NextAhead
from gri.core.policy import PolicyState
from gri.core.trajectory import Trajectory
from gri.networks.decoder import dense
from gri.networks.fast_decoder import FewVehicles, bind_numpy
from gri.networks.model import RelationalModel
from gri.networks.pair_encoder import LENGTH

LOOK_AHEAD = 1.0  # [s] in which a vehicle that moves over counts as in the path, as in the safety filter
GAIN, FREE = 0.8, 0.5  # [1/s], [m/s]: the lateral speed that is left at the centre of the target lane, and before it
SLOWEST, LATERAL_ACCELERATION = 1.0, 3.0  # [m/s], [m/s²]
_LOOK_AHEAD, _OWN_WIDTH, _LENGTH, _NONE = (np.float32(value) for value in (LOOK_AHEAD, OWN_WIDTH, LENGTH, np.inf))


class FollowsNextAhead:
    """`model` under its graph, and behind the next vehicle ahead; a `Policy` that looks at the vehicles nearby.

    In a merge it does not turn farther to the side of the target lane than to be slow at the centre of that lane.

    Positions in its states are those of front bumpers, of vehicles 5 m long (`LENGTH`).

    Raises:
        ValueError: the model's graph has no type *follow*, or the model has a memory from step to step.
    """

    sees_nearby = True

    def __init__(self, model: RelationalModel) -> None:
        if EdgeType.FOLLOW not in model.config.vocabulary:
            raise ValueError(f"got a model of {model.config.vocabulary}, wanted one that knows what follow means")
        if model.decoder.memory_size:
            raise ValueError(
                "got a model with a memory, wanted a feed-forward decoder: a scene of two may end any time"
            )
        self.model = model
        dynamics = model.dynamics
        self._planar, self._speed = "y" in dynamics.state, dynamics.speed
        self._heading = dynamics.index("heading") if self._planar else 0
        self._lateral = [dynamics.index(name) for name in ("y", "v", "heading", "yaw_rate")] if self._planar else []
        self._in_pairs: dict[int, FewVehicles] = {}  # by the number of scenes of two
        self._unseen: tuple[tuple[int, int], ...] = ()

    def without(self, pairs: Iterable[tuple[int, int]]) -> "FollowsNextAhead":
        """The same policy, in which the receiver of each pair (sender, receiver) does not see the sender ahead of it.

        What the graph says of the pair is another matter.
        """
        other = FollowsNextAhead(self.model)
        other._unseen = tuple(pairs)
        return other

    @property
    def dynamics(self) -> Dynamics:
        """Layout and units of states and actions."""
        return self.model.dynamics

    @property
    def dt(self) -> float:
        """Time between two actions [s]."""
        return self.model.dt

    @property
    def history_steps(self) -> int:
        """Number of states from which the encoder infers the graph."""
        return self.model.history_steps

    def begin(self, history: Trajectory) -> PolicyState:
        """Infer the graph, as the model does."""
        return self.model.begin(history)

    def act(
        self, memory: PolicyState, state: Float[Tensor, "B N D"], nearby: Nearby | NextAhead | None = None
    ) -> tuple[Float[Tensor, "B N A"], PolicyState]:
        """The mean action under the graph; along the road at most that behind the next vehicle ahead."""
        action, memory = self.model.act(memory, state)
        values = state.detach().numpy()
        in_pairs = self._in_scenes(values.shape[0] * values.shape[1])
        outside = NextAhead.of(nearby) if isinstance(nearby, Nearby) else nearby
        who, leader = self.next_ahead(values, outside)[1:]
        if len(who):
            n, features = len(who), values.shape[2]
            scenes = np.empty((n, 2, features), values.dtype)
            scenes[:, 0], scenes[:, 1] = values.reshape(-1, features)[who], leader
            scenes[..., 0] -= leader[:, :1]  # as `relative`
            behind = (in_pairs if n == in_pairs.shape[0] else self._in_scenes(n))(scenes)
            along = action.numpy().reshape(-1, action.shape[2])[:, 0]
            along[who] = np.minimum(along[who], behind[:, 0, 0])
        if self._planar:
            turning = action.numpy()
            turning[..., 1] = np.minimum(turning[..., 1], self._greatest_turn(values))
        return action, memory

    def _greatest_turn(self, state: Float[np.ndarray, "B N D"]) -> Float[np.ndarray, "B N"]:
        """The greatest yaw acceleration [rad/s²] after which a vehicle stays in the lane that it merges into.

        y is 0 at the centre of that lane and grows to its far side. The heading of the next step is decided already.
        """
        y, v, heading, yaw_rate = (state[..., k] for k in self._lateral)
        dt, v = np.float32(self.dt), np.maximum(v, np.float32(SLOWEST))
        greatest = (np.float32(FREE) - np.float32(GAIN) * y) / v
        turn = (greatest - (heading + yaw_rate * dt)) / dt
        turn = np.maximum(turn, np.float32(-LATERAL_ACCELERATION) / v)
        return (turn - yaw_rate) / dt

    def few_vehicles(self, memory: PolicyState) -> tuple[FewVehicles, FewVehicles] | None:
        """What `act` computed last under the graph, as `RelationalModel.few_vehicles`, and behind who is next ahead.

        The latter is for as many scenes of two as there are vehicles: the first ones are those with a vehicle ahead.
        """
        numbers = None if self._unseen else self.model.few_vehicles(memory)
        return None if numbers is None else (numbers, self._in_scenes(numbers.vehicles))

    def _in_scenes(self, count: int) -> FewVehicles:
        """The model in so many scenes of two, in each of which vehicle 0 follows vehicle 1."""
        if self.model.training or count not in self._in_pairs:
            most = max(self._in_pairs, default=0)
            if self.model.training or count > most:
                vocabulary = self.model.config.vocabulary
                follow = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW}, vocabulary, 2, batch=count)
                with torch.no_grad():
                    few = bind_numpy(self.model.decoder, dense(follow.one_hot))
                assert isinstance(few, FewVehicles), "a feed-forward decoder drives two vehicles in numpy"
                self._in_pairs = {count: few}
            else:
                self._in_pairs[count] = self._in_pairs[most].first(count)
        return self._in_pairs[count]

    def next_ahead(
        self, state: Float[np.ndarray, "B N D"], outside: NextAhead | None
    ) -> tuple[Float[np.ndarray, "B N"], Int[np.ndarray, " K"], Float[np.ndarray, "K D"]]:
        """Net gap [m] from each vehicle to the next one ahead in its path, inf where there is none.

        Also the K vehicles that have one, counted through all groups, and the states of those ahead of them. A member
        of the group is known with its whole state, and in the path as soon as it will be within `LOOK_AHEAD`.
        Of others (`outside`) only place and speed are known; they count as driving straight on at a constant speed,
        beside nobody.
        """
        ahead = _from_each(state[..., 0])
        in_path: Bool[np.ndarray, "B N N"] = ahead > 0
        if self._planar:
            across = _from_each(state[..., 1])
            closer = _from_each(state[..., self._speed] * np.sin(state[..., self._heading]))
            closer *= -np.sign(across)
            np.maximum(closer, 0, out=closer)
            closer *= _LOOK_AHEAD
            in_path &= np.abs(across) - closer < _OWN_WIDTH
        for sender, receiver in self._unseen:
            in_path[:, receiver, sender] = False
        ahead -= _LENGTH
        gaps = np.where(in_path, ahead, _NONE)
        gap, flat = gaps.min(-1), state.reshape(-1, state.shape[2])
        if outside is not None:
            inside, gap = gap, np.minimum(gap, outside.gap)
        (who,) = np.nonzero(gap.ravel() < _NONE)
        group = who // state.shape[1]
        leader = flat[group * state.shape[1] + gaps.argmin(-1).ravel()[who]]
        if outside is not None and (nearer := (outside.gap < inside).ravel()[who]).any():
            own, v = flat[who[nearer]], outside.v.ravel()[who[nearer]]
            outsider = np.zeros_like(own)
            outsider[:, 0] = own[:, 0] + outside.gap.ravel()[who[nearer]] + _LENGTH
            if self._planar:
                outsider[:, 1] = own[:, 1]
            outsider[:, self._speed] = v
            leader[nearer] = outsider
        return gap, who, leader


def _from_each(values: Float[np.ndarray, "B N"]) -> Float[np.ndarray, "B N N"]:
    """How much greater the value of the last index is than that of the one before."""
    return values[:, None] - values[..., None]
