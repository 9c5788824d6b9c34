"""Environments for reinforcement learning: Gymnasium for one driven vehicle, PettingZoo for a group of three.

They are a thin face of the closed loop (`cosim.loop`): an episode is an ordinary drive whose policy waits for actions
(`waiting_policy`), in a fork of warmed-up traffic (`traffic_process`). Others use what is listed in `__all__`. The
extra `rl` brings gymnasium and pettingzoo; the import of this room tells Gymnasium of the environments. Begin with
`driving_env`, then `task` and `episodes`. `observation`, `actions` and `rewards` say what a learner gets and gives;
`learned_policy` drives with what it learned. docs/reinforcement-learning.md shows how to use them.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from gri.resources import shipped

if TYPE_CHECKING:
    from cosim.environments.driving_env import DrivingEnv
    from cosim.environments.learned_policy import LearnedPolicy, network_policy, save_network
    from cosim.environments.parallel_env import GroupEnv
    from cosim.environments.vector_env import DrivingVectorEnv

__all__ = ["DrivingEnv", "DrivingVectorEnv", "GroupEnv", "LearnedPolicy", "network_policy", "save_network"]

_HOMES = {
    "DrivingEnv": "cosim.environments.driving_env",
    "DrivingVectorEnv": "cosim.environments.vector_env",
    "GroupEnv": "cosim.environments.parallel_env",
    "LearnedPolicy": "cosim.environments.learned_policy",
    "network_policy": "cosim.environments.learned_policy",
    "save_network": "cosim.environments.learned_policy",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _register() -> None:
    """Tell Gymnasium of the environments "cosim/SCENARIO-v1", one per shipped scenario, and "cosim/scenario-v1"."""
    from gymnasium.envs.registration import register as register_environment
    from gymnasium.envs.registration import registry

    for name in (*sorted(path.stem for path in shipped("scenarios").glob("*.yaml")), "scenario"):
        if (known := f"cosim/{name}-v1") not in registry:
            given = {} if name == "scenario" else {"scenario": name}
            register_environment(
                known,
                "cosim.environments.driving_env:DrivingEnv",
                vector_entry_point="cosim.environments.vector_env:DrivingVectorEnv",
                kwargs=given,
            )


if find_spec("gymnasium"):  # a learned policy drives without it
    _register()
