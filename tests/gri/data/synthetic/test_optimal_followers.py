from pathlib import Path

import msgspec
import pytest
import torch

from gri.core.dynamics import POINT_MASS_1D
from gri.data.ranges.car_following import PAPER
from gri.data.store import DataConfig, scenes_of
from gri.data.synthetic.expert import returns, true_reward
from gri.data.synthetic.optimal_followers import OptimalExpert, ShiftedStarts, make_shifted_scenes
from gri.errors import InputError

SHIFTED = ShiftedStarts(scenes=12, position=(0.0, 12.0), beyond=5)


def test_half_of_the_starts_are_shifted_and_the_actions_lead_through_the_states():
    made = make_shifted_scenes(SHIFTED, PAPER, PAPER.one_graph, 0)
    assert made.state.shape == (12, 3, PAPER.steps, 3)
    headway = made.state[:, 1, 0, 0] - made.state[:, 0, 0, 0]
    assert bool(((headway[6:] > 4) & (headway[6:] < 8)).all())
    assert not bool(((headway[:6] > 4) & (headway[:6] < 8)).all())
    moved = POINT_MASS_1D.step(made.state[:, :2, :-1], made.action, PAPER.dt)
    torch.testing.assert_close(moved, made.state[:, :2, 1:], atol=1e-4, rtol=1e-4)


def test_no_other_actions_of_one_vehicle_have_a_higher_return(generator: torch.Generator):
    shifted = msgspec.structs.replace(SHIFTED, beyond=0)
    made = make_shifted_scenes(shifted, PAPER, PAPER.one_graph, 0)
    graph, reward = made.one_hot(2), true_reward(PAPER)
    best = returns(reward, made.state, made.action, graph)[:, 0].sum(-1)
    for _ in range(5):
        action, state = made.action.clone(), made.state.clone()
        action[:, 0] += 0.05 * torch.randn(action[:, 0].shape, generator=generator)
        for t in range(PAPER.steps - 1):
            state[:, 0, t + 1] = POINT_MASS_1D.step(state[:, 0, t], action[:, 0, t], PAPER.dt)
        assert bool((returns(reward, state, action, graph)[:, 0].sum(-1) < best).all())


def test_the_store_adds_them_to_the_training_scenes_only(tmp_path: Path):
    plain = DataConfig(range="paper", graphs="one", train=5, validation=2, test=3, expert_updates=1)
    without, added = scenes_of(plain, tmp_path), scenes_of(msgspec.structs.replace(plain, shifted=SHIFTED), tmp_path)
    assert len(added.train) == 5 + 12
    assert torch.equal(added.train.state[:5], without.train.state)
    assert torch.equal(added.test.state, without.test.state)
    lanes = DataConfig(range="lane_changing", graphs="one", shifted=SHIFTED)
    with pytest.raises(InputError, match=r"data\.shifted: got it for range lane_changing"):
        scenes_of(lanes, tmp_path)


def test_optimal_drivers_are_an_expert_without_noise(tmp_path: Path):
    data = DataConfig(range="paper", graphs="mixed", train=4, validation=1, test=2, expert=OptimalExpert(beyond=1))
    made = scenes_of(data, tmp_path)
    assert len(made.train) == 4
    headway = made.train.state[:, 1, 0, 0] - made.train.state[:, 0, 0, 0]
    assert bool(((headway > 4) & (headway < 8)).all())
    with pytest.raises(InputError, match=r"data\.action_noise: got noise for optimal drivers"):
        scenes_of(msgspec.structs.replace(data, action_noise=0.1), tmp_path)
