"""Trains PPO (stable-baselines3) to merge on US-101, and compares it with other drivers of the same vehicles.

    pip install 'gri-cosim[rl]'
    python examples/ppo_merge.py --out runs/ppo_merge

It writes `policy.npz`, a policy that scenarios, stress tests and batches take; `curve.csv` with a row per update, and
its picture; and `evaluation.csv`: the trained policy, an untrained one and others in `cosim run`, in the traffic of
seeds that were never trained on. The same command with `--resume` goes on after `--minutes` are over, or a crash.
See docs/reinforcement-learning.md for the result.
"""

import argparse
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure
from scipy.stats import binomtest
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

import cosim
from cosim.environments import DrivingVectorEnv, save_network
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import Scenario

TRAINING_SEED = 1
REWARD = {
    "completed": 2.0,
    "not_completed": -1.0,
    "contact": -4.0,
    "follow.lat": -0.003,
    "follow.dist": -0.05,
    "cut_in.dist": -0.05,
    "heading": -0.005,
    "acceleration": -0.001,
}
SAVED_EVERY = 10  # updates


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
        told: list[dict] = [{} for _ in rewards]  # to be late is a failure: no value of what would follow is added
        for k in np.flatnonzero(ended | truncated):
            outcome = {name: values[k] for name, values in infos["final_info"]["outcome"].items() if name[0] != "_"}
            told[k] |= {"terminal_observation": infos["final_obs"][k], "outcome": outcome}
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
    """Records how the episodes of each update ended, saves now and then, and stops after `seconds`."""

    def __init__(self, folder: Path, seconds: float) -> None:
        super().__init__()
        self._folder, self._until = folder, time.monotonic() + seconds
        self._file = folder / "curve.csv"
        self._rows = pd.read_csv(self._file).to_dict("records") if self._file.exists() else []
        self._began = time.monotonic() - (self._rows[-1]["seconds"] if self._rows else 0.0)
        self._outcomes: list[dict] = []

    def _on_step(self) -> bool:
        self._outcomes += [info["outcome"] for info in self.locals["infos"] if "outcome" in info]
        return time.monotonic() < self._until

    def _on_rollout_end(self) -> None:
        row = {"steps": self.num_timesteps, "seconds": round(time.monotonic() - self._began), **shares(self._outcomes)}
        self._rows.append(row)
        self._outcomes = []
        if len(self._rows) % SAVED_EVERY == 0:
            self.save()

    def save(self) -> None:
        """Write the model, and the curve that led to it."""
        self.model.save(self._folder / "model.zip")
        pd.DataFrame(self._rows).to_csv(self._file, index=False)


def shares(outcomes: list[dict]) -> dict[str, float]:
    """Of several drives: how many, and the shares that were completed, without contact, and in contact."""
    table = pd.DataFrame(outcomes, columns=["completed", "contact", "completed_without_contact"]).astype(float)
    return {"episodes": len(table), **table.mean().round(4).to_dict()}


def draw(curve: pd.DataFrame, file: Path) -> None:
    """Shares of the last ten updates over the steps."""
    figure = Figure(figsize=(6.4, 3.2), layout="constrained")
    axes = figure.subplots()
    for name, label in (("completed_without_contact", "merged without contact"), ("contact", "contact")):
        axes.plot(curve["steps"], curve[name].rolling(10, min_periods=1).mean(), label=label)
    axes.set(xlabel="steps", ylabel="share of the episodes", ylim=(0, 1))
    axes.legend()
    figure.savefig(file)


def learner(train: Episodes, parallel: int) -> PPO:
    """An untrained one."""
    model = PPO(
        "MlpPolicy",
        train,
        n_steps=1024 // parallel,
        batch_size=128,
        n_epochs=8,
        learning_rate=5e-4,
        gamma=0.99,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -0.7},
        seed=1,
        device="cpu",
    )
    with torch.no_grad():  # begin with lane changes at constant speed, which a learner would not find soon
        model.policy.action_net.bias[1] = 0.8
    return model


def save(model: PPO, file: Path, step: float, sees: str) -> None:
    """Write the mean action of the network as a policy file."""
    network = model.policy
    linear = [layer for layer in network.mlp_extractor.policy_net if isinstance(layer, torch.nn.Linear)]
    layers = [(layer.weight, layer.bias) for layer in (*linear, network.action_net)]
    arrays = [(weight.detach().numpy(), bias.detach().numpy()) for weight, bias in layers]
    save_network(file, arrays, dynamics="dubins", dt=step, sees=sees, name="ppo")


def evaluate(scenario: Scenario, out: Path, seeds: list[int], episodes: int) -> pd.DataFrame:
    """How each policy drives the merging vehicles in `cosim run`: shares with 95 % intervals, all seeds together."""
    network = {"kind": "python", "object": "cosim.environments:network_policy"}
    policies: dict[str, str | Mapping[str, Any] | None] = {
        "PPO": network | {"settings": {"file": str(out / "policy.npz")}},
        "PPO before training": network | {"settings": {"file": str(out / "untrained.npz")}},
        "intelligent driver model": "idm",
        "constant velocity": "constant_velocity",
        "policy of the scenario": None,
        "left to SUMO": "sumo",
    }
    rows = []
    for name, policy in policies.items():
        runs = [
            cosim.run(scenario, policy, seed=seed, episodes=episodes, overrides={"driven": [0]}, allow_code=True)
            for seed in seeds
        ]
        groups = pd.concat([run.groups for run in runs], ignore_index=True)
        rows.append({"policy": name, **summary(groups)})
        pd.DataFrame(rows).to_csv(out / "evaluation.csv", index=False)
    return pd.DataFrame(rows)


def summary(groups: pd.DataFrame) -> dict[str, float]:
    """Shares of merges without contact (with the ends of Wilson's interval) and of contacts, and who broke groups up.

    `or broken up by others` adds the groups that ended because a vehicle that the policy does not drive left its lane
    or cut in.
    """
    merged, others = (
        groups["completed_without_contact"].astype(bool),
        groups["broken_up_by"].isin(["others", "unknown"]),
    )
    interval = binomtest(int(merged.sum()), len(groups)).proportion_ci(method="wilson")
    return {
        "groups": len(groups),
        "merged without contact": round(float(merged.mean()), 3),
        "from": round(interval.low, 3),
        "to": round(interval.high, 3),
        "or broken up by others": round(float((merged | others & ~groups["contact"].astype(bool)).mean()), 3),
        "contact": round(float(groups["contact"].mean()), 3),
        "late or lane end": round(float(groups["ending"].isin(["late", "lane_end"]).mean()), 3),
        "seconds": round(float(groups["drive_duration"].mean()), 1),
    }


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--out", type=Path, default=Path("runs/ppo_merge"))
    arguments.add_argument("--scenario", default="us101_merge")
    arguments.add_argument(
        "--newcomers", choices=["end", "join"], default="join", help="what others do that come between"
    )
    arguments.add_argument("--sees", choices=["group", "everybody"], default="everybody")
    arguments.add_argument("--steps", type=int, default=400_000)
    arguments.add_argument("--minutes", type=float, default=100.0, help="of training, of this call")
    arguments.add_argument("--starts", type=int, default=100, help="of the training traffic")
    arguments.add_argument("--parallel", type=int, default=16, help="episodes that are driven at the same time")
    arguments.add_argument("--resume", action="store_true", help="go on with the model in --out")
    arguments.add_argument("--test-seeds", type=int, nargs="*", default=[11, 12, 13], help="of traffic for evaluation")
    arguments.add_argument("--evaluate", type=int, default=40, help="starts in each of them")
    given = arguments.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)

    scenario = load_scenario(given.scenario)
    group = msgspec.structs.replace(scenario.group, newcomers=given.newcomers)
    scenario = msgspec.structs.replace(scenario, group=group)
    changes = {"seed": TRAINING_SEED, "episodes": given.starts, "groups_at_once": 4, "watch": 4.0}
    traffic = DrivingVectorEnv(scenario, given.parallel, sees=given.sees, reward=REWARD, overrides=changes)
    train = Episodes(traffic)
    if given.resume:
        model = PPO.load(given.out / "model.zip", train, device="cpu")
    else:
        (given.out / "curve.csv").unlink(missing_ok=True)
        model = learner(train, given.parallel)
        save(model, given.out / "untrained.npz", scenario.step, given.sees)
    curve = Curve(given.out, 60 * given.minutes)
    model.learn(max(given.steps - model.num_timesteps, 0), callback=curve, reset_num_timesteps=False)
    train.close()
    curve.save()
    draw(pd.read_csv(given.out / "curve.csv"), given.out / "curve.svg")
    save(model, given.out / "policy.npz", scenario.step, given.sees)
    if given.test_seeds:
        print(evaluate(scenario, given.out, given.test_seeds, given.evaluate).to_string(index=False))


if __name__ == "__main__":
    main()
