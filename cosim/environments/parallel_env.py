"""The PettingZoo environment: several learners drive a group of three together, in SUMO's traffic."""

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Space
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv

from cosim.environments.actions import ActionKind
from cosim.environments.observation import ObservationKind
from cosim.environments.task import Episode, Starts, task_of
from cosim.spec.scenario import Scenario
from gri.errors import InputError


class GroupEnv(ParallelEnv[str, np.ndarray, np.ndarray]):
    """A group of three in the closed loop of a scenario (docs/reinforcement-learning.md).

    The agents are "vehicle_0" and "vehicle_1": the merging vehicle and the lag vehicle, or both followers. Vehicle 2 is
    the leader that SUMO drives, which all observe. All agents end together. The arguments are those of `DrivingEnv`;
    `roles` are the vehicles that learners drive.
    """

    metadata = {"name": "cosim_group_v1", "render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        scenario: str | Scenario = "us101_merge",
        *,
        roles: tuple[int, ...] = (0, 1),
        action: ActionKind = "targets",
        sees: ObservationKind = "group",
        reward: Mapping[str, float] | None = None,
        overrides: Mapping[str, Any] | None = None,
        render_mode: None = None,
    ) -> None:
        self._task = task_of(scenario, roles=roles, action=action, sees=sees, reward=reward, overrides=overrides)
        self._names = {role: f"vehicle_{role}" for role in roles}
        self.possible_agents = [*self._names.values()]
        self.agents: list[str] = []
        self.observation_spaces = {name: self._task.observation_space(role) for role, name in self._names.items()}
        self.action_spaces = {name: self._task.action_space() for name in self.possible_agents}
        self.render_mode = render_mode
        self._random: np.random.Generator | None = None
        self._starts = Starts(self._task)
        self._episode: Episode | None = None

    def observation_space(self, agent: str) -> Space[np.ndarray]:
        """The space of what an agent observes."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Space[np.ndarray]:
        """The space of an agent's actions."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Begin an episode, as `DrivingEnv.reset` does."""
        self._end_episode()
        if seed is not None or self._random is None:
            self._random, _ = seeding.np_random(seed)
            self._starts.forget()
        start, info = self._starts.next(self._random, options)
        self._episode = Episode(self._task, start, start.begin())
        self.agents = [*self.possible_agents]
        return self._by_name(self._episode.observations), {name: dict(info) for name in self.possible_agents}

    def step(
        self, actions: dict[str, np.ndarray]
    ) -> tuple[dict[str, np.ndarray], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Drive for one step; `infos` are those of `DrivingEnv.step`."""
        if self._episode is None:
            raise InputError("step: no episode is under way; call reset first")
        step = self._episode.step({role: actions[name] for role, name in self._names.items()})
        infos: dict[str, dict[str, Any]] = {name: {"terms": step.terms[role]} for role, name in self._names.items()}
        if step.ended:
            for info in infos.values():
                info["outcome"] = dict(step.facts or {})
            self.agents = []
            self._end_episode()
        ended = dict.fromkeys(self.possible_agents, step.ended and not step.truncated)
        truncated = dict.fromkeys(self.possible_agents, step.truncated)
        return self._by_name(step.observations), self._by_name(step.rewards), ended, truncated, infos

    def branch(self) -> "GroupEnv":
        """An environment that continues from the present state in a fork, as `DrivingEnv.branch`."""
        if self._episode is None:
            raise InputError("branch: no episode is under way; call reset first")
        other = copy.copy(self)
        other.agents = [*self.agents]
        other._random = copy.deepcopy(self._random)
        other._starts = self._starts.copy()
        other._episode = self._episode.branch()
        return other

    def close(self) -> None:
        """End the episode, and the traffic unless this is a branch."""
        self._end_episode()
        self._starts.close()

    def _end_episode(self) -> None:
        if self._episode is not None:
            self._episode.close()
        self._episode = None

    def _by_name(self, values: Mapping[int, Any]) -> dict[str, Any]:
        return {self._names[role]: value for role, value in values.items()}
