"""What both kinds of environments share: the scenario, who drives, and how a step of an episode is judged."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from jaxtyping import Float

from cosim.environments.actions import ActionKind, action_of, check_kind
from cosim.environments.episodes import Drive, Start, Traffic
from cosim.environments.observation import LARGEST, ObservationKind, check_seen, names_of, observe
from cosim.environments.rewards import Reward, reward_of
from cosim.spec.loading import load_scenario, override
from cosim.spec.scenario import Merge, Scenario
from cosim.world.episode import Ending
from gri.core.dynamics import DUBINS, POINT_MASS_1D, Dynamics
from gri.errors import InputError

Weights = Mapping[str, float]
TIME_IS_OVER = frozenset({Ending.HORIZON.value, Ending.LATE.value})
"""Endings that are a time limit and nothing that happened: Gymnasium's `truncated`."""


@dataclass(frozen=True)
class Task:
    """A scenario as a task for learners that drive `roles`, with actions of a kind; `rewards` are by role.

    `weights` are those of the reward's terms, None for the default.
    """

    scenario: Scenario
    roles: tuple[int, ...]
    action: ActionKind
    sees: ObservationKind
    weights: Weights | None

    @property
    def dynamics(self) -> Dynamics:
        """The dynamics of the group rule."""
        return DUBINS if isinstance(self.scenario.group, Merge) else POINT_MASS_1D

    @property
    def period(self) -> float:
        """Time [s] between two actions: a step of the environment."""
        return self.scenario.policy_period or self.scenario.step

    def observation_space(self, role: int) -> Box:
        """The space of what a role observes."""
        return Box(-LARGEST, LARGEST, (len(names_of(role, self.dynamics, self.sees)),), np.float32)

    def action_space(self) -> Box:
        """The space of actions, the same for all roles."""
        return Box(-1.0, 1.0, (len(self.dynamics.action),), np.float32)

    def rewards(self, lane_width: float | None = None) -> dict[int, Reward]:
        """The reward of every role that drives."""
        return {role: reward_of(self.scenario.group, role, self.weights, lane_width) for role in self.roles}


def task_of(
    scenario: str | Scenario,
    *,
    roles: tuple[int, ...],
    action: ActionKind,
    sees: ObservationKind,
    reward: Weights | None,
    overrides: Mapping[str, Any] | None,
) -> Task:
    """The task of a scenario, by name, path or value; its policy does not count.

    Raises `InputError` for a scenario, an override, a kind of action or observation, or a reward term that does not
    exist.
    """
    chosen = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    changes = {"surroundings": False, **(overrides or {})}
    chosen = override(chosen, {**changes, "policy": {"kind": "constant_velocity"}, "driven": list(roles)})
    check_kind(action)
    check_seen(sees)
    task = Task(chosen, roles, action, sees, None if reward is None else dict(reward))
    task.rewards()  # a term that does not exist is told before anything runs
    return task


@dataclass(frozen=True)
class Step:
    """What a step came to, by role; `ended` says whether the drive is over, `truncated` whether by its time limit."""

    observations: dict[int, np.ndarray]
    rewards: dict[int, float]
    terms: dict[int, dict[str, float]]
    ended: bool
    truncated: bool
    facts: Mapping[str, Any] | None


class Episode:
    """An episode of a task from its start on."""

    def __init__(self, task: Task, start: Start, drive: Drive) -> None:
        self._task, self._start, self._drive = task, start, drive
        self._rewards = task.rewards(start.lane_width)
        self._terms: dict[int, dict[str, float]] = {}  # of the step that is under way

    @property
    def observations(self) -> dict[int, np.ndarray]:
        """What every role observes at present."""
        task, drive = self._task, self._drive
        if task.sees == "group":
            seen = [observe(state, role, task.dynamics) for role, state in self._states_by_role().items()]
        else:
            seen = [
                observe(drive.states, role, task.dynamics, drive.nearby)[view] for role, view in self._views().items()
            ]
        return dict(zip(task.roles, seen, strict=True))

    def step(self, given: Mapping[int, Float[np.ndarray, " A"]]) -> Step:
        """Let every role take its action for one step."""
        self.send(given)
        return self.receive()

    def send(self, given: Mapping[int, Float[np.ndarray, " A"]]) -> None:
        """Begin a step, which `receive` ends; other episodes may go on meanwhile."""
        task, views = self._task, self._states_by_role()
        actions = np.zeros((3, len(task.dynamics.action)))
        for role in task.roles:
            own = views[role][role].astype(float)
            actions[role] = action_of(np.asarray(given[role]), own, task.action, task.dynamics, task.period)
        self._drive.send(actions)
        self._terms = {
            role: self._rewards[role].of_step(views[role].astype(float), actions[role]) for role in task.roles
        }

    def receive(self) -> Step:
        """What the step came to that `send` began."""
        self._drive.receive()
        terms, facts = self._terms, self._drive.facts
        if facts is not None:
            terms = {role: of | self._rewards[role].of_outcome(facts) for role, of in terms.items()}
        return Step(
            observations=self.observations,
            rewards={role: float(sum(of.values())) for role, of in terms.items()},
            terms=terms,
            ended=facts is not None,
            truncated=facts is not None and facts["ending"] in TIME_IS_OVER,
            facts=facts,
        )

    def branch(self) -> "Episode":
        """A copy that continues from the present instant on its own."""
        return Episode(self._task, self._start, self._drive.branch())

    def close(self) -> None:
        """End the process of the episode."""
        self._drive.close()

    def _states_by_role(self) -> dict[int, np.ndarray]:
        """The states as each role observes them."""
        return {role: self._drive.states[view] for role, view in self._views().items()}

    def _views(self) -> dict[int, int]:
        """The view of each role: there is one for all, or one for each that drives."""
        return {role: min(k, len(self._drive.states) - 1) for k, role in enumerate(self._task.roles)}


class Starts:
    """Draws the starts of episodes from the traffic of a scenario; every start comes once before one comes again.

    The first draw warms the traffic up.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._traffic: Traffic | None = None
        self._order: list[int] = []
        self._is_copy = False

    def next(self, random: np.random.Generator, options: Mapping[str, Any] | None) -> tuple[Start, dict[str, Any]]:
        """The next start, or the one of the number that the options choose ("start").

        Also what `reset` tells of it: its number and of how many, the ids of the group, and the time [s].
        """
        if self._traffic is None:
            self._traffic = Traffic(self._task.scenario, sees_nearby=self._task.sees == "everybody")
        starts, number = self._traffic.starts, (options or {}).get("start")
        if number is None:
            self._order = self._order or random.permutation(len(starts)).tolist()
            number = self._order.pop()
        elif not isinstance(number, int | np.integer) or not 0 <= number < len(starts):
            raise InputError(f"reset: got start {number!r}, expected a number from 0 to {len(starts) - 1}")
        start = starts[number]
        facts = {"start": int(number), "starts": len(starts), "group": start.group.ids, "time": start.group.time}
        return start, facts

    def forget(self) -> None:
        """Draw a new order at the next start: the seed has changed."""
        self._order = []

    def copy(self) -> "Starts":
        """The same draws for another environment of the same traffic; only the original closes the traffic."""
        other = copy.copy(self)
        other._order, other._is_copy = [*self._order], True
        return other

    def close(self) -> None:
        """End the traffic, unless this is a copy."""
        if self._traffic is not None and not self._is_copy:
            self._traffic.close()
        self._traffic, self._order = None, []
