"""Imitates the followers of scenes that `cosim scenes` cut from SUMO's traffic (behaviour cloning), and drives them.

    cosim scenes us101_car_following --kind car_following --count 400 --out runs/scenes
    python examples/imitate_scenes.py runs/scenes/scenes.parquet --out runs/imitation

A network learns the acceleration of vehicle 0 at the next step from what an environment would show of the scene. It is
saved as `policy.npz` and driven in closed loop, beside constant velocity and the intelligent driver model.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import torch

from cosim.environments import network_policy, save_network
from cosim.environments.actions import ACCELERATION, BRAKING
from cosim.environments.observation import observe
from cosim.world.road_frame import model_offsets
from gri.core.dynamics import POINT_MASS_1D
from gri.core.graph import FOLLOWING
from gri.data.scene_file.reading import read

STEP = 0.2  # [s]
Choose = Callable[[np.ndarray], np.ndarray]


def examples_of(file: Path, split: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Observations of vehicle 0, and the action of the environment that gives its acceleration at the next step."""
    scenes = read(file, "car_following", POINT_MASS_1D, FOLLOWING, split=split)
    state = scenes.trajectory.state.numpy()
    state[..., 0] += model_offsets(scenes.length.numpy())[..., None]  # every vehicle ahead counts as 5 m long
    seen = observe(state[:, :, :-1].swapaxes(1, 2), 0, POINT_MASS_1D)  # Shape: (scenes, steps, features)
    following = state[:, 0, 1:, 2]
    number = np.where(following < 0, following / BRAKING, following / ACCELERATION).clip(-1, 1)
    return torch.from_numpy(seen.reshape(-1, seen.shape[-1])), torch.from_numpy(number.reshape(-1, 1)).float()


def fit(inputs: torch.Tensor, targets: torch.Tensor, epochs: int) -> torch.nn.Sequential:
    """A network with the least mean squared error."""
    torch.manual_seed(1)
    network = torch.nn.Sequential(
        torch.nn.Linear(inputs.shape[1], 32),
        torch.nn.Tanh(),
        torch.nn.Linear(32, 32),
        torch.nn.Tanh(),
        torch.nn.Linear(32, 1),
    )
    optimizer = torch.optim.Adam(network.parameters(), lr=2e-3)
    for _ in range(epochs):
        for part in torch.randperm(len(inputs)).split(256):
            optimizer.zero_grad()
            torch.nn.functional.mse_loss(network(inputs[part]), targets[part]).backward()
            optimizer.step()
    return network


def idm(observation: np.ndarray) -> np.ndarray:
    """The intelligent driver model behind vehicle 1 as an action of the environment."""
    from gri.core.policy import IntelligentDriver

    v, x, relative = (
        torch.tensor(float(value)) for value in (observation[0] * 15, observation[2] * 30, observation[3] * 5)
    )
    a = float(IntelligentDriver(STEP).target_acceleration(v, v + relative, x))
    return np.array([a / BRAKING if a < 0 else a / ACCELERATION])


def drive(env: gymnasium.Env, choose: Choose) -> dict[str, float]:
    """Drive once from every start: the shares of outcomes, and the mean return."""
    outcomes, returns = [], []
    _, info = env.reset()
    for start in range(info["starts"]):
        observation, _ = env.reset(options={"start": start})
        total, over = 0.0, False
        while not over:
            observation, reward, ended, truncated, info = env.step(choose(observation))
            total, over = total + float(reward), ended or truncated
        outcomes.append(info["outcome"])
        returns.append(total)
    shares = {name: float(np.mean([one[name] for one in outcomes])) for name in ("completed", "contact", "order_kept")}
    return {"episodes": len(outcomes), **shares, "return": round(float(np.mean(returns)), 3)}


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("scenes", type=Path)
    arguments.add_argument("--out", type=Path, default=Path("runs/imitation"))
    arguments.add_argument("--scenario", default="us101_car_following")
    arguments.add_argument("--seed", type=int, default=11, help="of the traffic in which the policy drives")
    arguments.add_argument("--starts", type=int, default=30)
    arguments.add_argument("--epochs", type=int, default=60)
    given = arguments.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)

    network = fit(*examples_of(given.scenes, "train"), given.epochs)
    inputs, targets = examples_of(given.scenes, "test")
    with torch.no_grad():
        error, constant = (float((answer - targets).square().mean()) for answer in (network(inputs), targets.mean()))
    linear = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
    layers = [(layer.weight.detach().numpy(), layer.bias.detach().numpy()) for layer in linear]
    save_network(given.out / "policy.npz", layers, dynamics="point_mass_1d", dt=STEP, name="imitation")

    learned = network_policy(STEP, str(given.out / "policy.npz"))
    changes = {"seed": given.seed, "episodes": given.starts}
    env = gymnasium.make("cosim/scenario-v1", scenario=given.scenario, overrides=changes)
    policies: dict[str, Choose] = {
        "imitation": lambda observation: learned.predict(observation[None])[0],
        "intelligent driver model": idm,
        "constant speed": lambda observation: np.zeros(1),
    }
    results = {name: drive(env, choose) for name, choose in policies.items()}
    env.close()
    results["squared error on test scenes"] = {"imitation": error, "a constant": constant}
    (given.out / "evaluation.json").write_text(json.dumps(results, indent=2) + "\n")
    print(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
