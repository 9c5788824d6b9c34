import ast
from pathlib import Path

import pytest
import torch

from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph
from gri.data.store import DataConfig, scenes_of
from gri.data.synthetic import idm_drivers
from gri.data.synthetic.idm_drivers import IdmExpert, drive, wanted_acceleration
from gri.errors import InputError

CHAIN = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW}, FOLLOWING).map
EMPTY = torch.zeros_like(CHAIN)
START = torch.tensor([[[-12.0, 5.0, 0.0], [-6.0, 5.0, 0.0], [0.0, 5.0, 0.0]]])
DRIVERS = {
    "wished_speed": 8.0,
    "time_headway": 1.0,
    "standstill": 2.0,
    "acceleration": 1.5,
    "deceleration": 1.5,
    "lag": 0.5,
}


def constant(speed: float, steps: int) -> torch.Tensor:
    time = 0.2 * torch.arange(steps)
    return torch.stack([speed * time, torch.full_like(time, speed), torch.zeros_like(time)], -1)[None]


def test_the_wanted_acceleration_by_hand():
    drivers = {name: torch.full((1, 2), value) for name, value in DRIVERS.items()}
    follows = torch.zeros(1, 3, 2, dtype=torch.bool)
    follows[0, 1, 0] = True
    wanted = wanted_acceleration(drivers, START, follows)
    free = 1.5 * (1 - (5 / 8) ** 4)
    torch.testing.assert_close(wanted, torch.tensor([[free - 1.5 * (7 / 6) ** 2, free]]))


def test_a_vehicle_without_an_edge_does_not_notice_the_others(generator: torch.Generator):
    expert = IdmExpert(wished_speed=(8.0, 8.0))
    near = drive(expert, START, constant(5.0, 40), EMPTY, 0.2, 0.0, torch.Generator().manual_seed(1))
    far = START.clone()
    far[:, 0, 0] = -500.0
    away = drive(expert, far, constant(5.0, 40), EMPTY, 0.2, 0.0, torch.Generator().manual_seed(1))
    torch.testing.assert_close(near.state[:, 0, :, 1:], away.state[:, 0, :, 1:])
    assert float(near.state[0, 0, -1, 1]) > 7.0  # it drives towards its wished speed


def test_followers_come_to_rest_behind_a_leader_that_stands():
    driven = drive(IdmExpert(), START, constant(0.0, 60), CHAIN, 0.2, 0.0, torch.Generator().manual_seed(2))
    assert bool((driven.state[0, :2, -1, 1] < 0.3).all())
    assert float((driven.state[0, 1:, :, 0] - driven.state[0, :2, :, 0]).min()) > 0.5


def test_noise_is_on_the_jerk_of_every_step():
    def driven(noise: float) -> torch.Tensor:
        generator = torch.Generator().manual_seed(3)
        return drive(IdmExpert(), START, constant(5.0, 20), CHAIN, 0.2, noise, generator).action

    difference = (driven(0.5) - driven(0.0))[0, :, 0]
    assert bool((difference != 0).all())


def test_the_drivers_share_nothing_with_rewards_networks_or_training():
    tree = ast.parse(Path(idm_drivers.__file__).read_text())
    imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    assert not [name for name in imported if name.startswith(("gri.rewards", "gri.networks", "gri.training"))]


def test_the_store_makes_them_and_refuses_lanes(tmp_path: Path):
    data = DataConfig(range="paper", graphs="mixed", train=5, validation=2, test=3, expert=IdmExpert())
    made = scenes_of(data, tmp_path)
    assert len(made.train) == 5
    assert torch.equal(scenes_of(data, tmp_path).test.state, made.test.state)
    with pytest.raises(InputError, match=r"data\.expert: got another expert for range lane_changing"):
        scenes_of(DataConfig(range="lane_changing", graphs="one", train=1, expert=IdmExpert()), tmp_path)
