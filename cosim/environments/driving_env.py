"""The Gymnasium environment: a learner drives one vehicle of a group, in SUMO's traffic."""

import copy
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np

from cosim.environments.actions import ActionKind
from cosim.environments.observation import ObservationKind
from cosim.environments.task import Episode, Starts, task_of
from cosim.spec.scenario import Scenario
from gri.errors import InputError


class DrivingEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One vehicle of a group in the closed loop of a scenario (docs/reinforcement-learning.md).

    The first `reset` warms the traffic up. Every episode begins at a group of the scenario, which the seed selects, in
    a fork of this traffic. A step lasts the scenario's `policy_period`, or its `step`.

    Args:
        scenario: name of a shipped scenario, path of a YAML file, or a `Scenario`. Its policy does not count.
        role: the vehicle that the learner drives: 0 is the merging vehicle, or the last follower.
        action: "targets" or "dynamics" (`cosim.environments.actions`).
        sees: "group", or "everybody" near (`cosim.environments.observation`).
        reward: weights by term (`cosim.environments.rewards`); by default those of the group rule.
        overrides: top-level fields of the scenario to replace, such as `{"episodes": 100, "watch": 2.0}`. `episodes`
            is the number of starts.

    Raises:
        InputError: one of these does not fit; the message says what to change.
    """

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        scenario: str | Scenario = "us101_merge",
        *,
        role: int = 0,
        action: ActionKind = "targets",
        sees: ObservationKind = "group",
        reward: Mapping[str, float] | None = None,
        overrides: Mapping[str, Any] | None = None,
        render_mode: None = None,
    ) -> None:
        self._task = task_of(scenario, roles=(role,), action=action, sees=sees, reward=reward, overrides=overrides)
        self._role, self.render_mode = role, render_mode
        self.observation_space = self._task.observation_space(role)
        self.action_space = self._task.action_space()
        self._starts = Starts(self._task)
        self._episode: Episode | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `options={"start": 3}` selects the start instead of the seed.

        `info` has the number of the start, and of how many, the ids of the group, and the time [s] of the take-over.
        """
        super().reset(seed=seed)
        self._end_episode()
        if seed is not None:
            self._starts.forget()
        start, info = self._starts.next(self.np_random, options)
        self._episode = Episode(self._task, start, start.begin())
        return self._episode.observations[self._role], info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Drive for one step.

        `info["terms"]` are the weighted terms of the reward. After the last step `info["outcome"]` says how the drive
        ended: contact, completed, order_kept and the other columns of docs/reference/run-tables.md.
        """
        if self._episode is None:
            raise InputError("step: no episode is under way; call reset first")
        step = self._episode.step({self._role: action})
        info: dict[str, Any] = {"terms": step.terms[self._role]}
        if step.ended:
            info["outcome"] = dict(step.facts or {})
            self._end_episode()
        ended = step.ended and not step.truncated
        return step.observations[self._role], step.rewards[self._role], ended, step.truncated, info

    def branch(self) -> "DrivingEnv":
        """An environment that continues from the present state in a fork; this one does not notice.

        Both use the same traffic, which ends with the environment that was made first.
        """
        if self._episode is None:
            raise InputError("branch: no episode is under way; call reset first")
        other = copy.copy(self)
        other._np_random = copy.deepcopy(self.np_random)
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
