"""The PettingZoo environment: its checker, exact seeds, and branches."""

import warnings

import numpy as np

with warnings.catch_warnings():  # the module imports environments of PettingZoo that are out of date
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import parallel_api_test

STAY = {name: np.zeros(1, dtype=np.float32) for name in ("vehicle_0", "vehicle_1")}
BRAKE = {name: -np.ones(1, dtype=np.float32) for name in STAY}


def test_the_checker_of_pettingzoo_finds_nothing_wrong(group):
    parallel_api_test(group, num_cycles=30)


def test_agents_drive_one_group_and_end_together(group):
    """The states that they observe of each other agree, and time is over after two seconds."""
    observations, infos = group.reset(seed=2)
    assert group.agents == ["vehicle_0", "vehicle_1"]
    assert infos["vehicle_0"] == infos["vehicle_1"]
    follower, middle = observations["vehicle_0"], observations["vehicle_1"]
    assert follower[2] == -middle[2] > 0  # vehicle 1 is ahead of vehicle 0
    for _ in range(9):
        _, _, ended, truncated, _ = group.step(STAY)
        assert not any([*ended.values(), *truncated.values()])
    _, _, ended, truncated, infos = group.step(STAY)
    assert not any(ended.values())
    assert all(truncated.values())
    assert infos["vehicle_0"]["outcome"]["ending"] == "horizon"
    assert group.agents == []


def test_a_branch_continues_for_all_agents(group):
    group.reset(seed=2)
    group.step(STAY)
    branch = group.branch()
    braked, stayed = branch.step(BRAKE)[0], group.step(STAY)[0]
    branch.close()
    assert all(braked[name][1] < stayed[name][1] for name in STAY)  # the acceleration
    group.reset(seed=2)
    group.step(STAY)
    again = group.step(STAY)[0]
    assert all((again[name] == stayed[name]).all() for name in STAY)
