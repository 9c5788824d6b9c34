"""Trains PPO (stable-baselines3) to merge on US-101, and compares it with policies that learned nothing.

    pip install 'gri-cosim[rl]'
    python examples/ppo_merge.py --out runs/ppo_merge

It writes `policy.npz`, a policy that scenarios, stress tests and batches take; `curve.csv` with a row per update, and
its picture; and `evaluation.json`. The policy is trained in the traffic of seed 1, and evaluated in that of seed 11.
See docs/reinforcement-learning.md for the result.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure
from msgspec.structs import replace
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from cosim.environments import DrivingVectorEnv, save_network
from cosim.spec.loading import load_scenario

TRAINING_SEED, HELD_OUT_SEED = 1, 11
Choose = Callable[[np.ndarray], np.ndarray]


class Episodes(VecEnv):
    """Several episodes in one warmed-up traffic, as stable-baselines3 wants them."""

    def __init__(self, env: DrivingVectorEnv) -> None:
        self._env, self._actions = env, np.empty(0)
        self.render_mode = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> np.ndarray:
        return self._env.reset(seed=1)[0]

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict]]:
        observations, rewards, ended, truncated, infos = self._env.step(self._actions)
        told: list[dict] = [{"TimeLimit.truncated": bool(over)} for over in truncated]
        for k in np.flatnonzero(ended | truncated):
            told[k] |= {"terminal_observation": infos["final_obs"][k], "outcome": outcome_of(infos, k)}
        return observations, rewards.astype(np.float32), ended | truncated, told

    def close(self) -> None:
        self._env.close()

    def get_attr(self, attr_name, indices=None):
        return [getattr(self._env, attr_name)] * self.num_envs

    def set_attr(self, attr_name, value, indices=None):
        raise NotImplementedError

    def env_method(self, method_name, *method_args, indices=None, **method_kwargs):
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs


class Curve(BaseCallback):
    """Records how the episodes of each update ended, and stops after `seconds`."""

    def __init__(self, file: Path, seconds: float) -> None:
        super().__init__()
        self._file, self._until = file, time.monotonic() + seconds
        self._began, self._rows, self._outcomes = time.monotonic(), [], []

    def _on_step(self) -> bool:
        self._outcomes += [info["outcome"] for info in self.locals["infos"] if "outcome" in info]
        return time.monotonic() < self._until

    def _on_rollout_end(self) -> None:
        row = {"steps": self.num_timesteps, "seconds": round(time.monotonic() - self._began), **shares(self._outcomes)}
        self._rows.append(row)
        self._outcomes = []
        pd.DataFrame(self._rows).to_csv(self._file, index=False)


def shares(outcomes: list[dict]) -> dict[str, float]:
    """Of several drives: how many, and the shares that were completed, without contact, and in contact."""
    table = pd.DataFrame(outcomes, columns=["completed", "contact", "completed_without_contact"]).astype(float)
    return {"episodes": len(table), **table.mean().round(4).to_dict()}


def draw(curve: pd.DataFrame, file: Path) -> None:
    """Shares of the last five updates over the steps."""
    figure = Figure(figsize=(6.4, 3.2), layout="constrained")
    axes = figure.subplots()
    for name, label in (("completed_without_contact", "merged without contact"), ("contact", "contact")):
        axes.plot(curve["steps"], curve[name].rolling(5, min_periods=1).mean(), label=label)
    axes.set(xlabel="steps", ylabel="share of the episodes", ylim=(0, 1))
    axes.legend()
    figure.savefig(file)


def evaluate(env: DrivingVectorEnv, choose: Choose) -> dict:
    """Drive once from every start; several at the same time."""
    observations, infos = env.reset(seed=1)
    count, starts, returns = infos["starts"][0], infos["start"].copy(), np.zeros(env.num_envs)
    outcomes: dict[int, dict] = {}
    while len(outcomes) < count:
        observations, rewards, ended, truncated, infos = env.step(choose(observations))
        returns += rewards
        for k in np.flatnonzero(ended | truncated):
            outcomes.setdefault(int(starts[k]), {**outcome_of(infos, k), "return": returns[k]})
            starts[k], returns[k] = infos["start"][k], 0.0
    endings = pd.Series([outcome["ending"] for outcome in outcomes.values()]).value_counts().to_dict()
    mean = float(np.mean([outcome["return"] for outcome in outcomes.values()]))
    return {**shares([*outcomes.values()]), "return": round(mean, 3), "endings": endings}


def baselines(env: DrivingVectorEnv) -> dict[str, Choose]:
    """Policies that learned nothing."""
    return {
        "constant velocity": lambda observations: np.tile([0.0, -1.0], (len(observations), 1)),
        "lane change at constant speed": lambda observations: np.tile([0.0, 1.0], (len(observations), 1)),
        "random": lambda observations: env.action_space.sample(),
    }


def outcome_of(infos: dict, k: int) -> dict:
    """The outcome of an episode that ended."""
    return {name: values[k] for name, values in infos["final_info"]["outcome"].items() if name[0] != "_"}


def save(model: PPO, file: Path, step: float) -> None:
    """Write the mean action of the trained network as a policy file."""
    network = model.policy
    linear = [layer for layer in network.mlp_extractor.policy_net if isinstance(layer, torch.nn.Linear)]
    layers = [(layer.weight, layer.bias) for layer in (*linear, network.action_net)]
    arrays = [(weight.detach().numpy(), bias.detach().numpy()) for weight, bias in layers]
    save_network(file, arrays, dynamics="dubins", dt=step, name="ppo")


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--out", type=Path, default=Path("runs/ppo_merge"))
    arguments.add_argument("--scenario", default="us101_merge")
    arguments.add_argument("--warm-up", type=float, help="of the traffic [s], instead of the scenario's")
    arguments.add_argument("--steps", type=int, default=30_000)
    arguments.add_argument("--minutes", type=float, default=110.0)
    arguments.add_argument("--starts", type=int, default=60, help="of the training traffic")
    arguments.add_argument("--parallel", type=int, default=8, help="episodes that are driven at the same time")
    arguments.add_argument("--evaluate", type=int, default=100, help="starts in traffic that was held out")
    given = arguments.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)

    scenario = load_scenario(given.scenario)
    if given.warm_up:
        scenario = replace(scenario, traffic=replace(scenario.traffic, warm_up=given.warm_up))
    shorter = {"seed": TRAINING_SEED, "episodes": given.starts, "horizon": 10.0, "watch": 2.0}
    train = Episodes(DrivingVectorEnv(scenario, given.parallel, overrides=shorter))
    model = PPO(
        "MlpPolicy",
        train,
        n_steps=512 // given.parallel,
        batch_size=64,
        learning_rate=1e-3,
        gamma=0.98,
        ent_coef=0.0,
        policy_kwargs={"net_arch": [32, 32], "log_std_init": -0.7},
        seed=1,
        device="cpu",
    )
    with torch.no_grad():  # begin with lane changes at constant speed, which a learner would not find soon
        model.policy.action_net.bias[1] = 0.8
    model.learn(given.steps, callback=Curve(given.out / "curve.csv", 60 * given.minutes))
    train.close()
    draw(pd.read_csv(given.out / "curve.csv"), given.out / "curve.svg")
    save(model, given.out / "policy.npz", step=0.2)

    changes = {"seed": HELD_OUT_SEED, "episodes": given.evaluate}
    held_out = DrivingVectorEnv(scenario, given.parallel, overrides=changes)
    held_out.action_space.seed(1)
    policies: dict[str, Choose] = {"ppo": lambda observations: model.predict(observations, deterministic=True)[0]}
    results = {name: evaluate(held_out, choose) for name, choose in (policies | baselines(held_out)).items()}
    held_out.close()
    (given.out / "evaluation.json").write_text(json.dumps(results, indent=2) + "\n")
    print(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
