from math import exp

import msgspec
import pytest
import torch

from gri.core.graph import LANE_CHANGING, EdgeType, InteractionGraph, pairs
from gri.core.scale import LANE_CHANGING_PAPER
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.lane_changing_features import GoalForm, LaneConstants
from gri.rewards.structured import LaneRewardConfig, ShapedReward, StructuredReward, Units
from gri.rewards.terms import LaneUnits, RewardConfig, terms_of

CONFIG = LaneRewardConfig(
    constants=LaneConstants(
        following=FollowingConstants(standstill=2.0, time_headway=1.0, comfort=1.0, zeta=4.0, speed_limit=12.0),
        width=4.0,
        boundary=0.5,
        yield_headway=10.0,
    ),
    units=Units(gap=2.0),
    lane_units=LaneUnits(lateral=2.0, heading=0.1, yaw_rate=0.2, yaw_acceleration=0.5),
    temperature=0.5,
)
NODE = {
    "speed": 2.0,
    "acceleration": 3.0,
    "heading": 4.0,
    "yaw_rate": 5.0,
    "jerk": 6.0,
    "yaw_acceleration": 7.0,
    "lane": 8.0,
}
WEIGHTS = {
    "node": NODE,
    "follow": {"idm": 2.0, "dist": 3.0, "lat": 4.0},
    "yield": {"yield": 5.0, "dist": 6.0},
    "cut_in": {"goal": 7.0, "dist": 8.0},
}


def one_step(edges: dict[tuple[int, int], EdgeType], config: LaneRewardConfig = CONFIG) -> list[float]:
    """Rewards of the three vehicles: 0 changes lanes to the left, 8 m ahead of 1 and 10 m behind 2."""
    state = torch.tensor(
        [
            [0.0, -3.0, 10.0, 0.1, 2.0, 0.2],
            [-8.0, 0.0, 12.0, 0.0, 0.0, 0.0],
            [10.0, 0.0, 12.0, 0.0, 0.0, 0.0],
        ]
    )[None, :, None]
    action = torch.tensor([[1.0, 0.5], [0.0, 0.0], [0.0, 0.0]])[None, :, None]
    graph = InteractionGraph.of_edges(edges, LANE_CHANGING).one_hot
    return StructuredReward.with_weights(config, WEIGHTS)(state, action, graph)[0, :, 0].tolist()


# speed 4·2, acceleration 4·3, heading 1·4, yaw rate 1·5, jerk 1·6, yaw acceleration 1·7; 1 m from the boundary: e^-2·8
ALONE = 8 + 12 + 4 + 5 + 6 + 7 + 8 * exp(-2)
MIDDLE = 8 * exp(-8)  # in the middle of a lane, 2 m from its boundaries, at the limit


def test_a_vehicle_without_relations_by_hand():
    assert one_step({}) == pytest.approx([-0.5 * ALONE, -0.5 * MIDDLE, -0.5 * MIDDLE], rel=1e-5)


def test_following_by_hand():
    # wanted headway 2 + 10 + 10·(−2)/2 = 2 at 10 m: (8/2)²·2, collision e^{-6.25}·3, 3 m beside the lane: (3/2)²·4
    expected = ALONE + 32 + 3 * exp(-6.25) + 9
    assert one_step({(2, 0): EdgeType.FOLLOW})[0] == pytest.approx(-0.5 * expected, rel=1e-5)


def test_yielding_across_lanes_by_hand():
    # 8 m behind, 10 wanted: (2/2)²·5, collision e^{-4}·6
    assert one_step({(0, 1): EdgeType.YIELD})[1] == pytest.approx(-0.5 * (MIDDLE + 5 + 6 * exp(-4)), rel=1e-5)


def test_cutting_in_by_hand():
    # 8 m in front, 10 wanted: (2/2)²·7, collision e^{-4}·8
    assert one_step({(1, 0): EdgeType.CUT_IN})[0] == pytest.approx(-0.5 * (ALONE + 7 + 8 * exp(-4)), rel=1e-5)


def test_the_printed_goal_is_an_option_for_both_types():
    printed = msgspec.structs.replace(
        CONFIG, constants=msgspec.structs.replace(CONFIG.constants, goal=GoalForm.PRINTED)
    )
    edges = {(0, 1): EdgeType.YIELD, (1, 0): EdgeType.CUT_IN}
    paid = one_step(edges, printed)
    assert paid[0] == pytest.approx(-0.5 * (ALONE + 8 * exp(-4)), rel=1e-5)
    assert paid[1] == pytest.approx(-0.5 * (MIDDLE + 6 * exp(-4)), rel=1e-5)


def test_each_scenario_has_its_own_vocabulary():
    for config in (RewardConfig(), LaneRewardConfig()):
        terms, vocabulary = terms_of(config)
        assert set(terms.edge) == set(vocabulary) - {EdgeType.NONE}


def test_renumbering_the_vehicles_renumbers_the_rewards(generator: torch.Generator):
    order = [2, 0, 1]
    state = 3 * torch.randn(4, 3, 6, 6, generator=generator)
    action = torch.randn(4, 3, 6, 2, generator=generator)
    graph = torch.nn.functional.one_hot(torch.randint(0, 4, (4, 6), generator=generator), 4).float()
    edges = [pairs(3).index((order[i], order[j])) for i, j in pairs(3)]
    reward = StructuredReward(LaneRewardConfig())
    renumbered = reward(state[:, order], action[:, order], graph[:, edges])
    torch.testing.assert_close(renumbered, reward(state, action, graph)[:, order])


def test_the_scene_may_move_along_the_road_but_not_across_it(generator: torch.Generator):
    reward = ShapedReward(StructuredReward(LaneRewardConfig()), LANE_CHANGING_PAPER)
    state, action = torch.randn(2, 3, 6, 6, generator=generator), torch.zeros(2, 3, 5, 2)
    graph = torch.nn.functional.one_hot(torch.randint(0, 4, (2, 6), generator=generator), 4).float()
    along, across = torch.tensor([64.0, 0, 0, 0, 0, 0]), torch.tensor([0, 1.0, 0, 0, 0, 0])
    torch.testing.assert_close(reward(state + along, action, graph), reward(state, action, graph), rtol=1e-4, atol=1e-2)
    assert (reward(state + across, action, graph) - reward(state, action, graph)).abs().max() > 0.1
