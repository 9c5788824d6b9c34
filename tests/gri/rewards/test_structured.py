from math import exp

import pytest
import torch

from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph, pairs
from gri.core.scale import CAR_FOLLOWING_PAPER, LANE_CHANGING_PAPER
from gri.errors import InputError
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.structured import LaneRewardConfig, RewardConfig, ShapedReward, StructuredReward, Units

CONFIG = RewardConfig(
    constants=FollowingConstants(standstill=2.0, time_headway=1.0, comfort=1.0, zeta=4.0, speed_limit=12.0),
    units=Units(gap=2.0),
    temperature=0.5,
)
WEIGHTS = {"node": {"speed": 2.0, "acceleration": 3.0, "jerk": 4.0}, "follow": {"idm": 5.0, "dist": 6.0}}


def chain(batch: int = 1) -> torch.Tensor:
    edges = {(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW}
    return InteractionGraph.of_edges(edges, FOLLOWING, batch=batch).one_hot


def test_a_reward_by_hand():
    reward = StructuredReward.with_weights(CONFIG, WEIGHTS)
    state = torch.tensor([[[[0.0, 10.0, 2.0]], [[8.0, 10.0, 0.0]], [[30.0, 12.0, 0.0]]]])
    action = torch.tensor([[[[1.0]], [[0.0]], [[0.0]]]])
    values = reward(state, action, chain())[0, :, 0]
    # vehicle 0: speed 4·2, acceleration 4·3, jerk 1·4, IDM headway 12 at 8 m: (4/2)²·5, collision e^{-4}·6
    torch.testing.assert_close(values[0], torch.tensor(-0.5 * (8 + 12 + 4 + 20 + 6 * exp(-4))))
    # vehicle 1: speed 4·2, IDM headway 12 + 10·(−2)/2 = 2 at 22 m: (20/2)²·5, collision e^{-30.25}·6
    torch.testing.assert_close(values[1], torch.tensor(-0.5 * (8 + 500)))
    assert values[2].item() == 0.0  # the leader follows nobody and drives at the limit


def test_weights_exceed_one_whatever_psi():
    reward = StructuredReward(RewardConfig())
    with torch.no_grad():
        reward.psi["node"].fill_(-40.0)
    assert (reward.weights("node") >= 1).all()


def test_weights_survive_the_round_trip():
    reward = StructuredReward.with_weights(CONFIG, WEIGHTS)
    torch.testing.assert_close(reward.weights("follow"), 0.5 * torch.tensor([5.0, 6.0]))


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ({"follow": {"idm": 1.0, "dist": 2.0}}, "wanted all above 1"),
        ({"follow": {"idm": 3.0}}, "wanted all terms"),
        ({"yield": {"idm": 3.0}}, "weights of yield"),
    ],
)
def test_weights_that_no_reward_has_are_refused(weights: dict[str, dict[str, float]], message: str):
    with pytest.raises(InputError, match=message):
        StructuredReward.with_weights(CONFIG, WEIGHTS | weights)


def test_weights_just_above_one_are_possible_and_nothing_is_said_of_other_groups():
    reward = StructuredReward.with_weights(RewardConfig(), {"follow": {"dist": 1.5, "idm": 1.25}})
    assert reward.weights("follow").tolist() == pytest.approx([1.25, 1.5])
    assert reward.weights("node").tolist() == [2.0] * 3
    assert reward.names("node") == ("speed", "acceleration", "jerk")
    assert reward.names("follow") == ("idm", "dist")


def test_a_copy_in_double_precision_is_the_same_reward_with_fixed_weights(generator: torch.Generator):
    reward = StructuredReward.with_weights(CONFIG, WEIGHTS)
    reward.log_alpha.data.fill_(0.5)
    copy = reward.in_double()
    assert {p.dtype for p in copy.parameters()} == {torch.float64}
    assert not any(p.requires_grad for p in copy.parameters())
    assert all(p.requires_grad for p in reward.parameters())
    assert copy.log_alpha.item() == 0.5
    state, action = torch.randn(2, 3, 4, 3, generator=generator), torch.randn(2, 3, 4, 1, generator=generator)
    found, wanted = copy.of_vehicles(state.double(), action.double()), reward.of_vehicles(state, action)
    torch.testing.assert_close(found.float(), wanted)
    torch.testing.assert_close(
        copy.of_edges(state.double(), state.double() + 1).float(), reward.of_edges(state, state + 1)
    )
    graph = torch.rand(2, 6, 2, generator=generator)
    whole = copy(state.double(), action.double(), graph.double())
    assert whole.dtype == torch.float64
    torch.testing.assert_close(whole.float(), reward(state, action, graph))


def test_shaping_works_in_double_precision_as_well(generator: torch.Generator):
    shaped = ShapedReward(StructuredReward.with_weights(CONFIG, WEIGHTS), CAR_FOLLOWING_PAPER)
    state, action = torch.randn(2, 3, 5, 3, generator=generator), torch.randn(2, 3, 4, 1, generator=generator)
    graph = torch.rand(2, 6, 2, generator=generator)
    wanted = shaped(state, action, graph)
    found = shaped.double()(state.double(), action.double(), graph.double())
    assert found.dtype == torch.float64
    torch.testing.assert_close(found.float(), wanted)


def known_potentials() -> ShapedReward:
    """With potentials that are weighted sums of what the networks read, so that each input has a digit of its own."""
    shaped = ShapedReward(StructuredReward.with_weights(CONFIG, WEIGHTS), CAR_FOLLOWING_PAPER)
    shaped.vehicle, shaped.relation = torch.nn.Linear(2, 1), torch.nn.Linear(5, 1)
    with torch.no_grad():
        shaped.vehicle.weight.copy_(torch.tensor([[1.0, 10.0]]))
        shaped.relation.weight.copy_(torch.tensor([[1.0, 10.0, 100.0, 1e3, 1e4]]))
        for network in (shaped.vehicle, shaped.relation):
            network.bias.zero_()
        shaped.bias.fill_(0.25)
    return shaped


def test_potentials_by_hand():
    """Units 5 m, 2 m/s and 1 m/s², speeds from 5 m/s on: 7 m/s is 1, 9 m/s is 2; 10 m are 2."""
    state = torch.tensor([[[[30.0, 7.0, 3.0]], [[40.0, 9.0, 4.0]], [[45.0, 5.0, 0.0]]]])
    vehicle, edges = known_potentials().potentials(state)
    assert vehicle[0, :, 0].tolist() == pytest.approx([31.0, 42.0, 0.0])
    assert edges[0, pairs(3).index((1, 0)), 0].tolist() == pytest.approx([0.0, 2 + 20 + 400 + 1000 + 30000])
    assert edges[0, pairs(3).index((0, 1)), 0].tolist() == pytest.approx([0.0, -2 + 10 + 300 + 2000 + 40000])


def test_there_is_one_potential_for_the_vehicle_and_one_per_edge_type():
    """Offsets and units are no parameters: a checkpoint does not hold them."""
    shaped = ShapedReward(StructuredReward(LaneRewardConfig()), LANE_CHANGING_PAPER)
    vehicle, edges = shaped.potentials(torch.ones(2, 3, 4, 6))
    assert (tuple(vehicle.shape), tuple(edges.shape)) == ((2, 3, 4), (2, 6, 4, 4))
    assert not edges[..., 0].any()
    assert edges[..., 1:].all()
    assert shaped.vehicle(torch.zeros(5)).shape == (1,)
    assert {"offset", "unit"}.isdisjoint(shaped.state_dict())


def test_the_shaped_reward_adds_what_the_potentials_gain_in_each_step(generator: torch.Generator):
    """f = r + h(x') − h(x) at every step, and the constant once per vehicle and step."""
    shaped = known_potentials()
    state, action = torch.randn(2, 3, 4, 3, generator=generator), torch.randn(2, 3, 3, 1, generator=generator)
    vehicle, edge = shaped.potentials(state)
    edges = shaped.edges(state)
    for t in range(3):
        ends = [[k for k, _ in pairs(3)], [k for _, k in pairs(3)]]
        plain = shaped.reward.of_edges(state[:, ends[0], t : t + 1], state[:, ends[1], t : t + 1])[:, :, 0]
        torch.testing.assert_close(edges[:, :, t], plain + edge[:, :, t + 1] - edge[:, :, t])
        alone = shaped.reward.of_vehicles(state[:, :, t : t + 1], action[:, :, t : t + 1])[..., 0]
        wanted = alone + vehicle[..., t + 1] - vehicle[..., t] + 0.25
        wanted[:, 0] += edges[:, pairs(3).index((1, 0)), t, 1]
        wanted[:, 1] += edges[:, pairs(3).index((2, 1)), t, 1]
        torch.testing.assert_close(shaped(state, action, chain(2))[..., t], wanted)


def test_a_cooperative_vehicle_knows_what_it_costs_others(generator: torch.Generator):
    state = torch.randn(2, 3, 4, 3, generator=generator).requires_grad_()
    value = StructuredReward(RewardConfig())(state, torch.zeros(2, 3, 4, 1), chain(2))
    (gradient,) = torch.autograd.grad(value[:, 0].sum(), state)
    assert gradient[:, 1].abs().max() > 0
    assert gradient[:, 2].abs().max() == 0, "2 is not ahead of 0 in the graph"


def test_type_none_pays_nothing(generator: torch.Generator):
    state = torch.randn(4, 3, 5, 3, generator=generator)
    action = torch.randn(4, 3, 5, 1, generator=generator)
    reward = StructuredReward(RewardConfig())
    empty = InteractionGraph.of_edges({}, FOLLOWING, batch=4).one_hot
    torch.testing.assert_close(reward(state, action, empty), reward.of_vehicles(state, action))


def test_renumbering_the_vehicles_renumbers_the_rewards(generator: torch.Generator):
    order = [2, 0, 1]
    state = 5 * torch.randn(4, 3, 6, 3, generator=generator)
    action = torch.randn(4, 3, 6, 1, generator=generator)
    graph = torch.nn.functional.one_hot(torch.randint(0, 2, (4, 6), generator=generator), 2).float()
    edges = [pairs(3).index((order[i], order[j])) for i, j in pairs(3)]
    reward = StructuredReward(RewardConfig())
    renumbered = reward(state[:, order], action[:, order], graph[:, edges])
    torch.testing.assert_close(renumbered, reward(state, action, graph)[:, order])


def test_reward_does_not_know_where_on_the_road_it_is(generator: torch.Generator):
    state, action = 5 * torch.randn(2, 3, 6, 3, generator=generator), torch.zeros(2, 3, 6, 1)
    reward = StructuredReward(RewardConfig())
    moved = state + torch.tensor([64.0, 0.0, 0.0])
    torch.testing.assert_close(reward(moved, action, chain(2)), reward(state, action, chain(2)), rtol=1e-4, atol=1e-3)


def test_potentials_telescope(generator: torch.Generator):
    """Over a trajectory, shaping adds h(x_T) − h(x_0) and the constant, whatever lies between."""
    torch.manual_seed(3)
    shaped = ShapedReward(StructuredReward(RewardConfig()), CAR_FOLLOWING_PAPER)
    state = torch.randn(2, 3, 8, 3, generator=generator)
    action = torch.randn(2, 3, 7, 1, generator=generator)
    plain = shaped.reward(state[:, :, :-1], action, chain(2)).sum(-1)
    node, edges = shaped.potentials(state)
    gained = node[..., -1] - node[..., 0]
    followed = edges[..., 1][..., -1] - edges[..., 1][..., 0]
    gained[:, 0] += followed[:, pairs(3).index((1, 0))]
    gained[:, 1] += followed[:, pairs(3).index((2, 1))]
    torch.testing.assert_close(shaped(state, action, chain(2)).sum(-1), plain + gained, rtol=1e-4, atol=1e-4)


def test_selfish_reward_keeps_gradients_from_the_vehicle_ahead(generator: torch.Generator):
    state = torch.randn(2, 3, 4, 3, generator=generator).requires_grad_()
    value = StructuredReward(RewardConfig())(state, torch.zeros(2, 3, 4, 1), chain(2), cooperative=False)
    (gradient,) = torch.autograd.grad(value[:, 0].sum(), state)
    assert gradient[:, 1:].abs().max() == 0
