"""The Gymnasium environment: the checker, exact seeds, branches, outcomes, and the same drives as `cosim run`."""

import time

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from msgspec.structs import replace

from cosim.environments import DrivingEnv, LearnedPolicy
from cosim.environments.actions import check_kind
from cosim.environments.observation import check_seen, names_of
from cosim.environments.waiting_policy import IDLE
from cosim.loop.closed_loop import run
from cosim.loop.driving import Driver
from cosim.spec.input_files import find_net
from cosim.traffic.simulation_input import SumoFiles
from gri.core.dynamics import DUBINS
from gri.errors import InputError

LEFT = np.array([0.0, 0.8], dtype=np.float32)


def drive(env: DrivingEnv, choose, **reset) -> tuple[list[np.ndarray], list[float], dict]:
    """The observations, the rewards and the last info of an episode."""
    observation, info = env.reset(**reset)
    observations, rewards, over = [observation], [], False
    while not over:
        observation, reward, ended, truncated, info = env.step(choose(observation))
        observations.append(observation)
        rewards.append(reward)
        over = ended or truncated
    return observations, rewards, info


def steer(observation: np.ndarray) -> np.ndarray:
    """Keeps the speed and drives to the centre of the target lane."""
    return np.array([0.0, 1.0], dtype=np.float32)


def test_the_checker_of_gymnasium_finds_nothing_wrong(merging):
    check_env(merging, skip_render_check=True)


def test_a_seed_gives_the_same_episode_bit_for_bit(merging):
    first, second = (drive(merging, steer, seed=5) for _ in range(2))
    assert all((a == b).all() for a, b in zip(first[0], second[0], strict=True))
    assert first[1:] == second[1:]


def test_a_seed_gives_the_same_episode_in_other_processes(merging, merge_scenario):
    """The traffic is warmed up again."""
    other = DrivingEnv(merge_scenario)
    try:
        found, again = (drive(env, steer, seed=5) for env in (merging, other))
    finally:
        other.close()
    assert all((a == b).all() for a, b in zip(found[0], again[0], strict=True))
    assert found[1:] == again[1:]


def test_a_copy_that_waited_and_one_that_is_forked_at_once_are_the_same(merging):
    time.sleep(3 * IDLE)  # the start keeps a spare copy by now
    spare = drive(merging, steer, options={"start": 2})
    merging.reset(options={"start": 2})
    forked = drive(merging, steer, options={"start": 2})  # no time has been for another spare
    assert all((a == b).all() for a, b in zip(spare[0], forked[0], strict=True))
    assert spare[1:] == forked[1:]


def test_seeds_and_successive_episodes_have_different_starts(merging):
    by_seed = {merging.reset(seed=seed)[1]["start"] for seed in range(12)}
    assert by_seed == set(range(4))
    _, info = merging.reset(seed=0)
    in_turn = [info["start"], *(merging.reset()[1]["start"] for _ in range(3))]
    assert sorted(in_turn) == [0, 1, 2, 3]


def test_a_branch_continues_from_the_present_and_changes_nothing(merging):
    alone = drive(merging, steer, options={"start": 1})
    merging.reset(options={"start": 1})
    for observation in alone[0][:4]:
        merging.step(steer(observation))
    branch = merging.branch()
    nested = branch.branch()
    apart = branch.step(-LEFT)[0]
    same, other = merging.step(steer(alone[0][4]))[0], nested.step(steer(alone[0][4]))[0]
    branch.close()
    nested.close()
    assert (same == alone[0][5]).all()
    assert (other == alone[0][5]).all()
    assert (apart != same).any()
    observation, over, total = same, False, 0
    while not over:  # the original goes on after its branches have ended
        observation, _, ended, truncated, _ = merging.step(steer(observation))
        over, total = ended or truncated, total + 1
    assert total == len(alone[0]) - 6


def test_the_outcome_tells_merging_from_driving_on(merging):
    merged = [drive(merging, steer, options={"start": k})[2]["outcome"] for k in range(4)]
    stayed = [drive(merging, lambda _: np.array([0.0, -1.0]), options={"start": k})[2]["outcome"] for k in range(4)]
    assert {outcome["ending"] for outcome in stayed} <= {"late", "lane_end", "cut_in", "lane_left", "contact"}
    assert not any(outcome["completed"] for outcome in stayed)
    assert sum(outcome["completed"] and not outcome["contact"] for outcome in merged) >= 2


def test_reward_terms_are_chosen_by_name_and_weight(merge_scenario, merging):
    weights = {"completed": 3.0, "not_completed": -1.0, "jerk": -0.5, "follow.lat": -2.0}
    env = DrivingEnv(merge_scenario, reward=weights)
    env._starts = merging._starts.copy()
    observations, rewards, info = drive(env, steer, options={"start": 0})
    assert set(info["terms"]) == set(weights)
    outcome = info["outcome"]
    assert info["terms"]["completed"] == 3.0 * outcome["completed"]
    assert info["terms"]["not_completed"] == -1.0 * (not outcome["completed"])
    assert rewards[-1] == pytest.approx(sum(info["terms"].values()))
    env.reset(options={"start": 0})
    terms = env.step(np.array([1.0, 0.0]))[4]["terms"]
    a, y = observations[0][3] * 3.0, observations[0][0] * 4.0
    assert terms["jerk"] == pytest.approx(-0.5 * ((2.5 - a) / 0.2) ** 2, rel=1e-4)
    assert terms["follow.lat"] == pytest.approx(-2.0 * y**2, rel=1e-4)


def test_an_episode_is_the_drive_of_the_closed_loop(merging, merge_scenario, tmp_path):
    """A run with the same policy has the same groups, trajectories and outcomes."""

    def predict(observation: np.ndarray) -> np.ndarray:
        return steer(observation[0])[None]

    scenario = replace(merge_scenario, driven=(0,), surroundings=False)
    files = SumoFiles(find_net(scenario.net), tmp_path / "routes.rou.xml", tmp_path / "sumo.log")
    outcome = run(scenario, files, Driver("learned", LearnedPolicy(predict, 0.2, DUBINS)), lambda *_: None)
    assert len(outcome.episodes) == 4
    for k, episode in enumerate(outcome.episodes):
        assert merging.reset(options={"start": k})[1]["group"] == episode.group.ids
        observations, _, info = drive(merging, steer, options={"start": k})
        found, speeds = info["outcome"], 15.0 * np.array([observation[1] for observation in observations])
        assert found["ending"] == episode.ending.value
        assert found["contact"] == episode.outcome.contact
        assert found["driven_s"] == pytest.approx(episode.end - episode.group.time)
        v = episode.feature("v")[episode.during_drive]
        assert speeds == pytest.approx(v[:, 0], abs=1e-5)
        relative = 5.0 * np.array([observation[7] for observation in observations])
        assert speeds + relative == pytest.approx(v[:, 1], abs=1e-5)


def test_a_learner_that_sees_everybody_sees_the_same_in_a_run(merge_scenario, tmp_path):
    """A policy whose actions depend on every number that it sees drives the same in both."""
    names = names_of(0, DUBINS, "everybody")
    weights = np.random.default_rng(3).normal(size=(2, len(names))) / len(names)

    def predict(observation: np.ndarray) -> np.ndarray:
        return np.tanh(observation @ weights.T)

    env = DrivingEnv(merge_scenario, sees="everybody")
    try:
        assert env.observation_space.contains(env.reset(options={"start": 1})[0])
        driven = [drive(env, predict, options={"start": k})[0] for k in range(4)]
    finally:
        env.close()
    scenario = replace(merge_scenario, driven=(0,), surroundings=False)
    files = SumoFiles(find_net(scenario.net), tmp_path / "routes.rou.xml", tmp_path / "sumo.log")
    policy = LearnedPolicy(predict, 0.2, DUBINS, sees="everybody")
    episodes = run(scenario, files, Driver("learned", policy), lambda *_: None).episodes
    for episode, observations in zip(episodes, driven, strict=True):
        speeds = 15.0 * np.array([observation[1] for observation in observations])
        assert speeds == pytest.approx(episode.feature("v")[episode.during_drive][:, 0], abs=1e-4)
        left = 100.0 * np.array([observation[names.index("lane_left")] for observation in observations])
        assert left[0] - left[1:] == pytest.approx(0.2 * np.cumsum(speeds[:-1]), rel=0.1, abs=0.2)
    ahead = [observation[names.index("path.ahead.gap")] for of in driven for observation in of]
    assert min(ahead) < 3.0 < max(ahead)


def test_resets_fork_and_do_not_warm_up_again(merging):
    merging.reset(seed=0)
    times = []
    for _ in range(20):
        began = time.perf_counter()
        merging.reset()
        times.append(time.perf_counter() - began)
    assert np.median(times) < 1.0  # about 10 ms on an idle machine; benchmarks/environments.py measures it


def test_what_does_not_fit_is_an_input_error(merging, merge_scenario):
    with pytest.raises(InputError, match="got the term 'speling', expected terms among"):
        DrivingEnv(merge_scenario, reward={"speling": 1.0})
    with pytest.raises(InputError, match="expected one of targets, dynamics"):
        check_kind("steering")
    with pytest.raises(InputError, match="sees: got 'all', expected one of group, everybody"):
        check_seen("all")
    with pytest.raises(InputError, match="call reset first"):
        DrivingEnv(merge_scenario).step(LEFT)
    with pytest.raises(InputError, match="from 0 to 3"):
        merging.reset(options={"start": 4})


@pytest.mark.slow
def test_a_traffic_without_groups_is_an_input_error(merge_scenario):
    env = DrivingEnv(merge_scenario, overrides={"time_limit": 2.0})
    with pytest.raises(InputError, match="no group fits the rule"):
        env.reset()
    env.close()


def test_every_shipped_scenario_is_registered():
    names = {name for name in gymnasium.registry if name.startswith("cosim/")}
    assert {"cosim/us101_merge-v1", "cosim/us101_car_following-v1", "cosim/i80_merge-v1", "cosim/scenario-v1"} <= names
    assert {"cosim/highway-v1", "cosim/highway_merge-v1"} <= names


@pytest.mark.slow
def test_environments_run_in_processes_of_gymnasium(merge_scenario):
    make = {"scenario": merge_scenario, "overrides": {"episodes": 2}}
    vector = gymnasium.make_vec("cosim/scenario-v1", num_envs=2, vectorization_mode="async", **make)
    try:
        first, _ = vector.reset(seed=[3, 3])
        second, rewards, *_ = vector.step(np.stack([LEFT, LEFT]))
    finally:
        vector.close()
    assert (first[0] == first[1]).all()
    assert (second[0] == second[1]).all()
    assert rewards[0] == rewards[1]
