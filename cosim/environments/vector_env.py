"""Several episodes at once in one warmed-up traffic: the vectorised form of `DrivingEnv`."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from cosim.environments.actions import ActionKind
from cosim.environments.observation import ObservationKind
from cosim.environments.task import Episode, Starts, task_of
from cosim.spec.scenario import Scenario
from gri.errors import InputError


class DrivingVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """`num_envs` episodes that are driven at the same time, each in a process of its own.

    All are forks of one traffic, so there is one warm-up, however many they are. The arguments are those of
    `DrivingEnv`. Where an episode ends, its next one begins in the same step: the observation is the first of the new
    episode, and `infos` has `final_obs` and `final_info` of the old one.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self,
        scenario: str | Scenario = "us101_merge",
        num_envs: int = 2,
        *,
        role: int = 0,
        action: ActionKind = "targets",
        sees: ObservationKind = "group",
        reward: Mapping[str, float] | None = None,
        overrides: Mapping[str, Any] | None = None,
        render_mode: None = None,
    ) -> None:
        self._task = task_of(scenario, roles=(role,), action=action, sees=sees, reward=reward, overrides=overrides)
        self._role, self.num_envs, self.render_mode = role, num_envs, render_mode
        self.single_observation_space = self._task.observation_space(role)
        self.single_action_space = self._task.action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._starts = Starts(self._task)
        self._episodes: list[Episode] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin all episodes; one seed gives the order of the starts, which all episodes share.

        The same seed and the same actions give the same episodes, bit for bit.
        """
        super().reset(seed=seed)
        self._end_episodes()
        if seed is not None:
            self._starts.forget()
        infos: dict[str, Any] = {}
        for k in range(self.num_envs):
            episode, info = self._begin(options)
            self._episodes.append(episode)
            infos = self._add_info(infos, info, k)
        return np.stack([episode.observations[self._role] for episode in self._episodes]), infos

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drive all episodes for one step, at the same time; infos are those of `DrivingEnv`."""
        if not self._episodes:
            raise InputError("step: no episodes are under way; call reset first")
        for episode, action in zip(self._episodes, actions, strict=True):
            episode.send({self._role: action})
        steps = [episode.receive() for episode in self._episodes]
        infos: dict[str, Any] = {}
        observations = [step.observations[self._role] for step in steps]
        for k, step in enumerate(steps):
            info: dict[str, Any] = {"terms": step.terms[self._role]}
            if step.ended:
                info["outcome"] = dict(step.facts or {})
                self._episodes[k].close()
                self._episodes[k], begun = self._begin(None)
                infos = self._add_info(infos, {"final_obs": observations[k], "final_info": info}, k)
                observations[k], info = self._episodes[k].observations[self._role], begun
            infos = self._add_info(infos, info, k)
        truncated = np.array([step.truncated for step in steps])
        ended = np.array([step.ended for step in steps]) & ~truncated
        rewards = np.array([step.rewards[self._role] for step in steps])
        return np.stack(observations), rewards, ended, truncated, infos

    def close_extras(self, **kwargs: Any) -> None:
        """End all episodes and the traffic."""
        self._end_episodes()
        self._starts.close()

    def _begin(self, options: Mapping[str, Any] | None) -> tuple[Episode, dict[str, Any]]:
        start, info = self._starts.next(self.np_random, options)
        return Episode(self._task, start, start.begin()), info

    def _end_episodes(self) -> None:
        for episode in self._episodes:
            episode.close()
        self._episodes = []
