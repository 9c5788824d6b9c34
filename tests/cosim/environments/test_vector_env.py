"""Several episodes at once are the episodes of `DrivingEnv`."""

import numpy as np

from cosim.environments import DrivingVectorEnv


def test_episodes_are_those_of_the_single_environment_one_after_the_other(merging, merge_scenario):
    """The episodes take the starts in the order of the seed, and end each at its own time."""
    vector = DrivingVectorEnv(merge_scenario, num_envs=2)
    vector._starts = merging._starts.copy()
    actions = np.array([[0.0, 1.0], [0.0, -1.0]], dtype=np.float32)
    observations, infos = vector.reset(seed=7)
    starts, ended = infos["start"].tolist(), {}
    assert starts == [merging.reset(seed=7)[1]["start"], merging.reset()[1]["start"]]
    seen = [[observation] for observation in observations]
    for _ in range(40):
        observations, _, terminated, truncated, infos = vector.step(actions)
        for k in range(2):
            if (terminated | truncated)[k] and k not in ended:
                seen[k].append(infos["final_obs"][k])
                ended[k] = infos["final_info"]["outcome"]["ending"][k]
                assert infos["start"][k] not in starts  # the next start of the order
            elif k not in ended:
                seen[k].append(observations[k])
        if len(ended) == 2:
            break
    vector.close()
    for k in range(2):
        observation, _ = merging.reset(options={"start": starts[k]})
        assert (observation == seen[k][0]).all()
        for expected in seen[k][1:]:
            observation, _, terminated, truncated, info = merging.step(actions[k])
            assert (observation == expected).all()
        assert terminated or truncated
        assert info["outcome"]["ending"] == ended[k]
