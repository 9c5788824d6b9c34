"""Scenes off the data in which vehicles maximise the learned return, for the policy to imitate.

The return differs by orders of magnitude between graphs. So back-propagation through roll-outs converges slowly. Newton
steps on one vehicle's actions (`gri.planning.ilqr`) converge quickly. Starting from the roll-outs of a planned
policy, each driven vehicle in turn is moved towards its best response to the present trajectories of the others. A few
sweeps come near an equilibrium of vehicles that foresee each other.
"""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.dynamics import constant_speed
from gri.core.graph import incoming
from gri.core.scenes import Scenes
from gri.networks.model import RelationalModel
from gri.networks.rollout import rollout
from gri.planning.ilqr import ControlProblem, maximise_ilqr
from gri.progress import Progress, no_progress
from gri.rewards.structured import StructuredReward
from gri.training.optimisation import squared_error


class OptimaSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Number and accuracy of the optimal scenes."""

    scenes: int = 2000
    sweeps: int = 2
    """Passes over all driven vehicles."""
    iterations: int = 12
    """Newton steps per vehicle and sweep."""
    beyond: int = 0
    """Steps added to the horizon after the end of the scene, during which the leader keeps its speed.

    A policy does not know when a scene ends. So it cannot imitate actions that are optimal only because of the end.
    """


def optimal_scenes(
    model: RelationalModel,
    reward: StructuredReward,
    start: Float[Tensor, "B N D"],
    leader: Float[Tensor, "B T D"],
    graph: Float[Tensor, "B E K"],
    settings: OptimaSettings,
    progress: Progress = no_progress,
) -> Scenes:
    """Scenes in which every driven vehicle plays its best response under the one-hot graph.

    The model's roll-outs from `start` are the first guess. `leader` is the trajectory of the last vehicle.
    """
    steps = leader.shape[1]
    further = constant_speed(leader[:, -1], settings.beyond, model.dynamics, model.dt)
    with torch.no_grad():
        driven = rollout(model, start, graph, torch.cat([leader, further[:, 1:]], 1))
    scenes = Scenes(driven.state.double(), driven.action.double(), graph.argmax(-1))
    reward = reward.in_double()
    for sweep in range(settings.sweeps):
        progress("optima", sweep + 1, settings.sweeps, 0.0)
        for vehicle in range(driven.action.shape[1]):
            scenes = improve_vehicle(scenes, vehicle, model, reward, settings.iterations)
    return Scenes(scenes.state[:, :, :steps].float(), scenes.action[:, :, : steps - 1].float(), scenes.graph)


def improve_vehicle(
    scenes: Scenes, vehicle: int, model: RelationalModel, reward: StructuredReward, iterations: int
) -> Scenes:
    """The scenes with the actions of one vehicle improved by `iterations` Newton steps.

    Scenes whose edges into the vehicle have the same types are improved together.
    """
    state, action = scenes.state.clone(), scenes.action.clone()
    others, kinds = incoming(scenes.graph, vehicle, state.shape[1])
    for shared in kinds.unique(dim=0):
        chosen = (kinds == shared).all(-1).nonzero()[:, 0]
        given = scenes.state[chosen][:, others, :-1]
        task = ControlProblem(
            state[chosen, vehicle, 0],
            given,
            tuple(shared.tolist()),
            reward,
            model.dynamics,
            model.dt,
            model.config.never_reverse,
        )
        action[chosen, vehicle] = maximise_ilqr(task, action[chosen, vehicle], iterations)
        state[chosen, vehicle] = task.simulate(action[chosen, vehicle])
    return Scenes(state, action, scenes.graph)


def distance_to_optima(model: RelationalModel, optima: Scenes, scale: float) -> Float[Tensor, ""]:
    """Distance of the model's roll-outs from the optimal scenes: mean over scenes of s²·(√(1 + 2e/s²) − 1).

    e is the mean squared error as in `reconstruction_loss`, and s is `scale` [m]. Errors beyond s count only linearly,
    because under contradictory graphs no policy can reach the optimum.
    """
    graph = optima.one_hot(len(model.config.vocabulary))
    driven = rollout(model, optima.start, graph, optima.leader, detach_senders=True)
    error = squared_error(driven.state, optima.state, model.dynamics).mean((1, 2))
    return scale**2 * ((1 + 2 * error / scale**2).sqrt() - 1).mean()
