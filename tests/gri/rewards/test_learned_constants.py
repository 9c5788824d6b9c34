import pytest
import torch

from gri.rewards import car_following_features as features
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.learned_constants import NAMES, LearnedConstants
from gri.rewards.structured import AssumedReward, StructuredReward

FIRST = FollowingConstants(standstill=2.0, time_headway=0.5, comfort=1.5, minimum=1.0, zeta=3.0, speed_limit=9.0)


def test_untouched_constants_are_the_first_values():
    learned = LearnedConstants(FIRST)
    for name in NAMES:
        assert float(getattr(learned, name).detach()) == pytest.approx(getattr(FIRST, name))
    assert list(learned.values()) == list(NAMES)


def test_constants_stay_positive_and_change_by_a_factor():
    learned = LearnedConstants(FIRST)
    with torch.no_grad():
        learned.log_ratio[NAMES.index("time_headway")] = torch.tensor(2.0).log()
    torch.testing.assert_close(learned.time_headway.detach(), torch.tensor(1.0))
    assert float(learned.standstill.detach()) == 2.0


def test_the_reward_has_a_gradient_in_every_constant_that_the_scene_depends_on():
    reward = StructuredReward(AssumedReward(constants=FIRST))
    assert reward.constants is not None
    sender, receiver = torch.tensor([[6.0, 5.0, 0.0]]), torch.tensor([[0.0, 4.0, 0.0]])
    value = reward.of_vehicles(receiver[None, None], torch.zeros(1, 1, 1, 1)).sum()
    value = value + reward.of_edges(sender[None, None], receiver[None, None])[..., 1].sum()
    value.backward()
    assert reward.constants.log_ratio.grad is not None
    gradient = dict(zip(NAMES, reward.constants.log_ratio.grad.tolist(), strict=True))
    assert gradient["minimum"] == 0.0  # 2 + 4·0.5 + … is above the least headway
    assert all(gradient[name] for name in NAMES if name != "minimum")


def test_a_given_reward_has_no_parameters_for_constants():
    assert StructuredReward(AssumedReward(constants=FIRST, learn=False)).constants is None


def test_features_are_the_same_with_learned_and_given_constants():
    sender, receiver = torch.tensor([8.0, 5.0, 0.0]), torch.tensor([0.0, 6.0, 0.5])
    for feature in (features.g_idm, features.g_dist):
        torch.testing.assert_close(
            feature(sender, receiver, LearnedConstants(FIRST)).detach(), feature(sender, receiver, FIRST)
        )


def test_a_copy_in_double_precision_keeps_what_was_learned():
    reward = StructuredReward(AssumedReward(constants=FIRST))
    assert reward.constants is not None
    with torch.no_grad():
        reward.constants.log_ratio.fill_(0.3)
    copy = reward.in_double()
    assert copy.constants is not None
    assert copy.constants.values().keys() == reward.constants.values().keys()
    torch.testing.assert_close(
        torch.tensor(list(copy.constants.values().values())), torch.tensor(list(reward.constants.values().values()))
    )
