from math import exp

import msgspec
import pytest
import torch
from torch import Tensor

from gri.core.graph import FOLLOWING, LANE_CHANGING, YIELDING, EdgeType, InteractionGraph, pairs
from gri.core.scale import LANE_CHANGING_PAPER
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.lane_changing_features import GoalForm, LaneConstants
from gri.rewards.learned_constants import LearnedConstants
from gri.rewards.recorded_traffic_features import ReferenceNetworks, References
from gri.rewards.structured import LaneRewardConfig, ShapedReward, StructuredReward, Units
from gri.rewards.terms import (
    AnyRewardConfig,
    AssumedReward,
    LaneUnits,
    NaturalisticConfig,
    RewardConfig,
    Terms,
    constants_of,
    references_of,
    terms_of,
)

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


FOLLOWER, LEADER = torch.tensor([5.0, 10.0, 2.0]), torch.tensor([13.0, 11.0, 0.0])
BEHIND, AHEAD = torch.tensor([5.0, -1.5, 10.0, 0.3, 2.0, 0.2]), torch.tensor([13.0, 0.5, 11.0, 0.0, 0.0, 0.0])


def values(terms: Terms, sender: Tensor, receiver: Tensor, action: Tensor) -> dict[str, float]:
    """All terms by name, those of edges with their type in front."""
    node = {name: term(receiver, action).item() for name, term in terms.node.items()}
    edges = ((kind, name, term) for kind, named in terms.edge.items() for name, term in named.items())
    return node | {f"{kind} {name}": term(sender, receiver).item() for kind, name, term in edges}


class Known(ReferenceNetworks):
    """References whose values are known: 20 m/s, half of the headway plus the leader's speed, and so on."""

    def own_speed(self) -> Tensor:
        return torch.tensor(20.0)

    def speed(self, headway: Tensor, sender_speed: Tensor) -> Tensor:
        return 0.5 * headway + sender_speed

    def headway(self, sender_speed: Tensor, receiver_speed: Tensor) -> Tensor:
        return receiver_speed - 0.1 * sender_speed

    def distance(self, sender_speed: Tensor, receiver_speed: Tensor) -> Tensor:
        return 2 * receiver_speed - sender_speed

    def time(self, sender_speed: Tensor, receiver_speed: Tensor) -> Tensor:
        return receiver_speed / sender_speed


def of(config: AnyRewardConfig) -> dict[str, float]:
    """The terms of vehicle "0" behind "1"."""
    known = None
    if isinstance(config, NaturalisticConfig):
        known = Known(config.references, config.lanes)
    terms, vocabulary = terms_of(config, known)
    two_dimensional = vocabulary is not FOLLOWING
    action = torch.tensor([3.0, 0.5] if two_dimensional else [3.0])
    return values(terms, *((AHEAD, BEHIND) if two_dimensional else (LEADER, FOLLOWER)), action)


IN_LINE = NaturalisticConfig(lanes=True, references=References(overlap=3.0))


@pytest.mark.parametrize("config", [RewardConfig(), LaneRewardConfig(), NaturalisticConfig(), IN_LINE])
def test_a_term_is_measured_in_its_unit(config: AnyRewardConfig):
    """In a unit of 3 instead of 1 a term is 1/9, because features are squared. Each term has one unit."""
    units = {name: 1.0 for name in Units.__struct_fields__}
    plain = msgspec.structs.replace(config, units=Units(**units))
    places = {("units", name): name for name in units}
    if isinstance(plain, LaneRewardConfig):
        plain = msgspec.structs.replace(plain, lane_units=LaneUnits(heading=1.0, yaw_rate=1.0, yaw_acceleration=1.0))
        places |= {("lane_units", name): name for name in LaneUnits.__struct_fields__}
    if isinstance(plain, NaturalisticConfig):
        plain = msgspec.structs.replace(plain, lateral=1.0, lateral_speed=1.0, time=1.0)
        places |= dict.fromkeys([(None, name) for name in ("lateral", "lateral_speed", "time")], "")
    before, measured = of(plain), dict.fromkeys(of(plain), 0)
    assert all(before.values()), "a term that is 0 shows nothing"
    for owner, name in places:
        changed = (
            {name: 3.0} if owner is None else {owner: msgspec.structs.replace(getattr(plain, owner), **{name: 3.0})}
        )
        after = of(msgspec.structs.replace(plain, **changed))
        for term, value in after.items():
            assert value == pytest.approx(before[term]) or value == pytest.approx(before[term] / 9)
            measured[term] += value != pytest.approx(before[term])
    assert set(measured.values()) == {1}


def test_terms_of_recorded_traffic_by_hand():
    """Follower at 10 m/s, 8 m behind a leader at 11 m/s; references are those of `Known`."""
    config = NaturalisticConfig(units=Units())
    assert of(config) == pytest.approx(
        {
            "speed": 100.0,  # (10 − 20)²
            "acceleration": 4.0,
            "jerk": 9.0,
            "follow speed": 25.0,  # (10 − (0.5·8 + 11))²
            "follow headway": 0.81,  # (10 − 1.1 − 8)²
        },
        rel=1e-5,
    )
    far = terms_of(config, Known(config.references))[0].edge[EdgeType.FOLLOW]["headway"]
    assert far(LEADER + torch.tensor([1.5, 0, 0]), FOLLOWER).item() == 0.0, "no cost of a longer headway"


def test_terms_of_recorded_lane_changes_by_hand():
    """The receiver [5, −1.5, 10, 0.3] and the sender [13, 0.5, 11, 0] (x, y, vx, vy); their paths cross.

    2 m to the side at 0.3 m/s take 6.667 s, in which the receiver drives 66.67 m and the sender 73.33 m, to 86.33 m:
    the point is 66.67 m ahead of the receiver, 58.67 m ahead of the sender, which is there after 5.333 s.
    """
    config = NaturalisticConfig(lanes=True, units=Units(), lateral_speed=1.0, references=References(overlap=1.0))
    assert terms_of(config, Known(config.references, True))[1] is YIELDING
    found = of(config)
    assert found == pytest.approx(
        {
            "speed": 100.0,
            "acceleration": 4.0,
            "jerk": 9.0,
            "lane": 2.25,
            "lateral_speed": 0.09,
            "lateral_acceleration": 0.04,
            "lateral_jerk": 0.25,
            "follow speed": 25.0,
            "follow headway": 0.81,
            "yield spatial": 0.0,  # 9 m wanted
            "yield time": 0.0,  # 0.909 s wanted, 1.333 s are there
        },
        rel=1e-4,
    )
    in_line = msgspec.structs.replace(IN_LINE, units=Units())
    assert of(in_line)["yield spatial"] == pytest.approx(1.0), "9 − 8: the point is where the sender is"
    assert of(in_line)["yield time"] == pytest.approx((10 / 11 - 0.8) ** 2, rel=1e-4)


def test_networks_and_constants_belong_to_the_rewards_that_learn_them():
    assert [references_of(config) for config in (RewardConfig(), LaneRewardConfig(), AssumedReward())] == [None] * 3
    assert [constants_of(config) for config in (RewardConfig(), LaneRewardConfig(), AssumedReward(learn=False))] == [
        None
    ] * 3
    for lanes in (False, True):
        found = references_of(NaturalisticConfig(lanes=lanes))
        assert isinstance(found, ReferenceNetworks)
        assert hasattr(found, "h_d") == lanes
    assert isinstance(constants_of(AssumedReward()), LearnedConstants)


def test_learned_constants_take_the_place_of_those_of_the_configuration():
    config = AssumedReward(constants=FollowingConstants(speed_limit=12.0))
    learned = constants_of(config)
    assert learned is not None
    speed = terms_of(config, constants=learned)[0].node["speed"]
    assert speed(FOLLOWER, torch.zeros(1)).item() == pytest.approx(4.0)
    with torch.no_grad():
        learned.log_ratio += 1.0
    assert speed(FOLLOWER, torch.zeros(1)).item() == pytest.approx((12 * exp(1) - 10) ** 2, rel=1e-5)


def test_terms_of_recorded_traffic_need_their_networks():
    with pytest.raises(AssertionError, match="networks"):
        terms_of(NaturalisticConfig())
