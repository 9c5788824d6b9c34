"""Car-following scenes in which every driver plays its best response to the true reward; no policy is trained.

`OptimalExpert` makes all scenes of a data set in this way: experts that are not a network of the student's class.

`ShiftedStarts` are demonstrations for baselines that cannot maximise a reward off the data. Grounded training rolls its
policy out from starts that cover the tested headways. These scenes give a baseline the same starts, with the best
response to the true reward under the true graph. That is more than grounded training gets: it maximises the reward that
it has learned.
"""

import msgspec
import torch

from gri.core.dynamics import dynamics_named
from gri.core.graph import incoming
from gri.core.scenes import Scenes
from gri.data.ranges.car_following import SceneRange
from gri.data.ranges.graph_shares import GraphShare
from gri.data.ranges.leader import uniform
from gri.data.synthetic.expert import sample_graphs, sample_row, true_reward
from gri.planning.best_response import initial_actions
from gri.planning.ilqr import ControlProblem, maximise_ilqr


class OptimalExpert(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="optimal"):
    """Drivers that foresee the others and maximise the true reward."""

    beyond: int = 15
    """Steps added to the horizon that are cut off again: the actions do not depend on the end of the scene."""


class ShiftedStarts(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Number of demonstrations and range of the shifts."""

    scenes: int = 2000
    position: tuple[float, float] = (0.0, 30.0)
    """Uniform shift of each driven vehicle along the road, in half of the scenes [m]."""
    beyond: int = 15
    """As in `OptimalExpert`."""


SWEEPS = 2
"""Passes over both driven vehicles."""
FIRST_ITERATIONS, ITERATIONS = 6, 12
"""Newton steps from every initial guess, and from the best of them."""


def make_optimal_scenes(
    expert: OptimalExpert, scenes: SceneRange, graphs: tuple[GraphShare, ...], count: int, seed: int
) -> Scenes:
    """`count` scenes of optimal drivers from the starts of the range."""
    unshifted = ShiftedStarts(scenes=count, position=(0.0, 0.0), beyond=expert.beyond)
    return make_shifted_scenes(unshifted, scenes, graphs, seed)


@torch.no_grad()
def make_shifted_scenes(
    shifted: ShiftedStarts, scenes: SceneRange, graphs: tuple[GraphShare, ...], seed: int
) -> Scenes:
    """Scenes from shifted starts in which both driven vehicles play their best response to the true reward."""
    generator = torch.Generator().manual_seed(seed)
    start, leader = sample_row(scenes, shifted.scenes, generator, scenes.steps + shifted.beyond)
    amount = uniform(generator, *shifted.position, len(start), 2)
    amount[len(start) // 2 :] = 0
    start[:, :2, 0] += amount
    start, leader = start.double(), leader.double()
    graph = sample_graphs(graphs, len(start), generator, scenes.vocabulary)
    dynamics, reward, steps = dynamics_named(scenes.dynamics), true_reward(scenes).in_double(), leader.shape[1]
    action = torch.zeros(len(start), 2, steps - 1, 1, dtype=torch.double)
    state = torch.zeros(len(start), 3, steps, 3, dtype=torch.double)
    state[:, 2] = leader
    for j in range(2):  # every vehicle keeps its speed at first
        state[:, j] = start[:, j, None]
        state[:, j, :, 0] += scenes.dt * torch.arange(steps) * start[:, j, 1:2]
    for sweep in range(SWEEPS):
        for j in (1, 0):  # the leader of the chain first
            others, kinds = incoming(graph, j, 3)
            for shared in kinds.unique(dim=0):
                chosen = (kinds == shared).all(-1).nonzero()[:, 0]
                task = ControlProblem(
                    start[chosen, j], state[chosen][:, others, :-1], tuple(shared.tolist()), reward, dynamics, scenes.dt
                )
                guess = action[chosen, j] if sweep else _best_guess(task, steps - 1)
                action[chosen, j] = maximise_ilqr(task, guess, ITERATIONS)
                state[chosen, j] = task.simulate(action[chosen, j])
    return Scenes(state[:, :, : scenes.steps].float(), action[:, :, : scenes.steps - 1].float(), graph)


def _best_guess(task: ControlProblem, actions: int) -> torch.Tensor:
    """The actions with the highest return after a few Newton steps, of several initial guesses."""
    found = [
        maximise_ilqr(task, guess.unflatten(-1, (actions, 1)), FIRST_ITERATIONS)
        for guess in initial_actions(len(task.start), actions, 1, task.dt)
    ]
    values = torch.stack([task.value(task.simulate(action)[:, :-1], action) for action in found])
    return torch.stack(found)[values.argmax(0), torch.arange(len(task.start))]
