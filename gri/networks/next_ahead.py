"""A relational policy that also follows whoever is next ahead in its lane, in its group or not.

The graph says to whom a vehicle reacts, and a policy knows nobody else. So a lag vehicle that yields to a merging one
does not see the leader before it, and nobody sees a vehicle of the surrounding traffic. Here every vehicle also asks
what it has learned of following: it is vehicle 0 of a scene of two, whose other vehicle is the next one ahead. The more
careful of both answers counts along the road; across it the graph decides alone.
"""

import copy
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gri.core.dynamics import Dynamics
from gri.core.graph import EdgeType, InteractionGraph
from gri.core.nearby import OWN_WIDTH, Nearby
from gri.core.policy import PolicyState
from gri.core.trajectory import Trajectory
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
        self._in_pairs = copy.copy(model)  # the same weights; each keeps what it made of its last graph
        self._follow = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW}, model.config.vocabulary, 2)

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
        gap, other = self.next_ahead(state, nearby)
        there = gap.isfinite()
        if not bool(there.any()):
            return action, memory
        scenes = torch.stack([state[there], other[there]], 1)
        if len(scenes) != len(self._follow):
            self._follow = replace(self._follow, logits=self._follow.logits[:1].expand(len(scenes), -1, -1))
        behind, _ = self._in_pairs.act(PolicyState(self._follow, self.model.memory(scenes)), scenes)
        careful = action.clone()
        careful[there, 0] = torch.minimum(action[there, 0], behind[:, 0, 0])
        return careful, memory

    def next_ahead(
        self, state: Float[Tensor, "B N D"], nearby: Nearby | None
    ) -> tuple[Float[Tensor, "B N"], Float[Tensor, "B N D"]]:
        """Net gap [m] from each vehicle to the next one ahead in its path, inf where there is none, and its state.

        A member of the group is known with its whole state, and in the path as soon as it will be within `LOOK_AHEAD`.
        Of others only place and speed are known; they count as driving straight on at a constant speed, beside nobody.
        """
        planar = "y" in self.dynamics.state
        y = state[..., 1] if planar else torch.zeros_like(state[..., 0])
        ahead, across = _from_each(state[..., 0]), _from_each(y)
        beside = across.abs()
        if planar:
            heading = state[..., self.dynamics.index("heading")]
            sideways = _from_each(state[..., self.dynamics.speed] * heading.sin())
            beside = beside - (-across.sign() * sideways).clamp_min(0.0) * LOOK_AHEAD
        in_path: Bool[Tensor, "B N N"] = (beside < OWN_WIDTH) & (ahead > 0)
        gaps = torch.where(in_path, ahead - LENGTH, torch.inf)
        gap, which = gaps.min(-1)
        other = torch.take_along_dim(state, which[..., None], 1)
        if nearby is None:
            return gap, other
        outside, v = nearby.next_ahead()
        outsider = torch.zeros_like(other)
        outsider[..., 0] = state[..., 0] + torch.where(outside.isfinite(), outside, 0.0) + LENGTH
        if planar:
            outsider[..., 1] = y
        outsider[..., self.dynamics.speed] = v
        nearer = outside < gap
        return torch.where(nearer, outside, gap), torch.where(nearer[..., None], outsider, other)


def _from_each(values: Float[Tensor, "B N"]) -> Float[Tensor, "B N N"]:
    """How much greater the value of the last index is than that of the one before."""
    return values[:, None] - values[..., None]
