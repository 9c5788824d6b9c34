"""A relational policy that also follows whoever is next ahead in its lane, in its group or not.

The graph says to whom a vehicle reacts, and a policy knows nobody else. So a lag vehicle that yields to a merging one
does not see the leader before it, and nobody sees a vehicle of the surrounding traffic. Here every vehicle also asks
what it has learned of following: it is vehicle 0 of a scene of two, whose other vehicle is the next one ahead. The more
careful of both answers counts along the road; across it the graph decides alone.
"""

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gri.core.dynamics import Dynamics
from gri.core.graph import EdgeType, InteractionGraph
from gri.core.nearby import OWN_WIDTH, Nearby
from gri.core.policy import PolicyState
from gri.core.trajectory import Trajectory
from gri.networks.decoder import dense
from gri.networks.fast_decoder import FewVehicles, bind_numpy
from gri.networks.model import RelationalModel
from gri.networks.pair_encoder import LENGTH

LOOK_AHEAD = 1.0  # [s] in which a vehicle that moves over counts as in the path, as in the safety filter


class FollowsNextAhead:
    """`model` under its graph, and behind the next vehicle ahead; a `Policy` that looks at the vehicles nearby.

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
        self._in_pairs: dict[int, FewVehicles] = {}  # by the number of scenes of two

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

    @torch.no_grad()
    def act(
        self, memory: PolicyState, state: Float[Tensor, "B N D"], nearby: Nearby | None = None
    ) -> tuple[Float[Tensor, "B N A"], PolicyState]:
        """The mean action under the graph; along the road at most that behind the next vehicle ahead."""
        action, memory = self.model.act(memory, state)
        values = state.numpy()
        in_pairs = self._in_scenes(values.shape[0] * values.shape[1])
        gap, other = self.next_ahead(values, nearby)
        there = np.isfinite(gap)
        scenes = np.stack([values[there], other[there]], 1)
        if len(scenes):
            scenes[..., 0] -= scenes[:, 1:, 0]  # as `relative`
            behind = (in_pairs if len(scenes) == there.size else self._in_scenes(len(scenes)))(scenes)
            careful = action.numpy()
            careful[there, 0] = np.minimum(careful[there, 0], behind[:, 0, 0])
        return action, memory

    def few_vehicles(self, memory: PolicyState) -> tuple[FewVehicles, FewVehicles] | None:
        """What `act` computed last under the graph, as `RelationalModel.few_vehicles`, and behind who is next ahead.

        The latter is for as many scenes of two as there are vehicles: the first ones are those with a vehicle ahead.
        """
        numbers = self.model.few_vehicles(memory)
        return None if numbers is None else (numbers, self._in_scenes(numbers.vehicles))

    def _in_scenes(self, count: int) -> FewVehicles:
        """The model in so many scenes of two, in each of which vehicle 0 follows vehicle 1."""
        if self.model.training or count not in self._in_pairs:
            most = max(self._in_pairs, default=0)
            if self.model.training or count > most:
                vocabulary = self.model.config.vocabulary
                follow = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW}, vocabulary, 2, batch=count)
                few = bind_numpy(self.model.decoder, dense(follow.one_hot))
                assert isinstance(few, FewVehicles), "a feed-forward decoder drives two vehicles in numpy"
                self._in_pairs = {count: few}
            else:
                self._in_pairs[count] = self._in_pairs[most].first(count)
        return self._in_pairs[count]

    def next_ahead(
        self, state: Float[np.ndarray, "B N D"], nearby: Nearby | None
    ) -> tuple[Float[np.ndarray, "B N"], Float[np.ndarray, "B N D"]]:
        """Net gap [m] from each vehicle to the next one ahead in its path, inf where there is none, and its state.

        A member of the group is known with its whole state, and in the path as soon as it will be within `LOOK_AHEAD`.
        Of others only place and speed are known; they count as driving straight on at a constant speed, beside nobody.
        """
        planar = "y" in self.dynamics.state
        ahead = _from_each(state[..., 0])
        in_path: Bool[np.ndarray, "B N N"] = ahead > 0
        if planar:
            across = _from_each(state[..., 1])
            heading = state[..., self.dynamics.index("heading")]
            sideways = _from_each(state[..., self.dynamics.speed] * np.sin(heading))
            beside = np.abs(across) - np.maximum(-np.sign(across) * sideways, 0) * np.float32(LOOK_AHEAD)
            in_path &= beside < np.float32(OWN_WIDTH)
        gaps = np.where(in_path, ahead - np.float32(LENGTH), np.float32(np.inf))
        which = gaps.argmin(-1)
        batch = np.arange(len(state))[:, None]
        gap, other = gaps[batch, np.arange(state.shape[1]), which], state[batch, which]
        if nearby is None:
            return gap, other
        outside, v = (of.numpy() for of in nearby.next_ahead())
        nearer = outside < gap
        if nearer.any():
            outsider = np.zeros((np.count_nonzero(nearer), state.shape[2]), state.dtype)
            outsider[:, 0] = state[nearer, 0] + outside[nearer] + np.float32(LENGTH)
            if planar:
                outsider[:, 1] = state[nearer, 1]
            outsider[:, self.dynamics.speed] = v[nearer]
            gap[nearer], other[nearer] = outside[nearer], outsider
        return gap, other


def _from_each(values: Float[np.ndarray, "B N"]) -> Float[np.ndarray, "B N N"]:
    """How much greater the value of the last index is than that of the one before."""
    return values[:, None] - values[..., None]
