"""Optima of the learned return away from the data, as scenes that the policy can imitate.

Back-propagation through roll-outs is slow to climb the last percents of a return that spans orders of magnitude from
graph to graph; Newton steps on one vehicle's actions (`gri.planning.ilqr`) do it at once. Each driven vehicle in turn
is moved to its best response to the others as they then drive, starting from a planned policy, so that any number of
steps is an improvement on it. A few sweeps come near an equilibrium of vehicles that foresee each other.
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
from gri.planning.ilqr import Task, climb_by_steps
from gri.progress import Progress, no_progress
from gri.rewards.structured import StructuredReward
from gri.training.optimisation import squared_error


class OptimaSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How many optima are computed, and how well."""

    scenes: int = 2000
    sweeps: int = 2
    iterations: int = 12
    """Newton steps per vehicle and sweep."""
    beyond: int = 0
    """Steps that an optimum foresees beyond the scene, where leaders keep their speed. A policy does not know how long
    a scene still lasts, and cannot do what pays only because it ends.
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
    """Every driven vehicle on its best response under the graph; the roll-outs of the model are the first guess."""
    steps = leader.shape[1]
    further = constant_speed(leader[:, -1], settings.beyond, model.dynamics, model.dt)
    with torch.no_grad():
        driven = rollout(model, start, graph, torch.cat([leader, further[:, 1:]], 1))
    scenes = Scenes(driven.state.double(), driven.action.double(), graph.argmax(-1))
    reward = reward.in_double()
    for sweep in range(settings.sweeps):
        progress("optima", sweep + 1, settings.sweeps, 0.0)
        for vehicle in range(driven.action.shape[1]):
            scenes = respond(scenes, vehicle, model, reward, settings.iterations)
    return Scenes(scenes.state[:, :, :steps].float(), scenes.action[:, :, : steps - 1].float(), scenes.graph)


def respond(scenes: Scenes, vehicle: int, model: RelationalModel, reward: StructuredReward, iterations: int) -> Scenes:
    """The scenes with one vehicle's actions improved; those with the same incoming edges are improved together."""
    state, action = scenes.state.clone(), scenes.action.clone()
    others, kinds = incoming(scenes.graph, vehicle, state.shape[1])
    for shared in kinds.unique(dim=0):
        chosen = (kinds == shared).all(-1).nonzero()[:, 0]
        given = scenes.state[chosen][:, others, :-1]
        task = Task(
            state[chosen, vehicle, 0],
            given,
            tuple(shared.tolist()),
            reward,
            model.dynamics,
            model.dt,
            model.config.never_reverse,
        )
        action[chosen, vehicle] = climb_by_steps(task, action[chosen, vehicle], iterations)
        state[chosen, vehicle] = task.simulate(action[chosen, vehicle])
    return Scenes(state, action, scenes.graph)


def distance(model: RelationalModel, optima: Scenes, scale: float) -> Float[Tensor, ""]:
    """How far the model's roll-outs are from the optima: s²·(√(1 + 2e/s²) − 1), mean over scenes.

    e is the mean squared error as in reconstruction; from s [m] on it counts linearly only, as graphs that ask for
    contradictory things have optima that no policy reaches.
    """
    graph = optima.one_hot(len(model.config.vocabulary))
    driven = rollout(model, optima.start, graph, optima.leader, selfish=True)
    error = squared_error(driven.state, optima.state, model.dynamics).mean((1, 2))
    return scale**2 * ((1 + 2 * error / scale**2).sqrt() - 1).mean()
