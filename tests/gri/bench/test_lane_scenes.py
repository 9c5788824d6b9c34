"""The type of lane scenes: summaries, scenes without a vehicle, balanced steps; worked by hand."""

import torch

from gri.bench.lane_scenes import (
    CUT_IN,
    FOLLOW,
    LAG,
    LEADER,
    MERGER,
    NONE,
    YIELD,
    LaneScenes,
    balanced_steps,
    close_gaps,
    joined,
    pairs_of_merger,
    pairs_that_may_react,
    role_pairs,
    shares,
    summary_graph,
)


def scenes(count: int = 2, steps: int = 10) -> LaneScenes:
    generator = torch.Generator().manual_seed(0)
    return LaneScenes(
        torch.rand(count, 3, steps, 4, generator=generator, dtype=torch.float64),
        torch.full((count,), 3.5),
        torch.full((count, 3), 5.0),
        torch.randint(4, (count, steps, 6), generator=generator),
        ("merge",) * count,
        (MERGER, LAG, LEADER),
        torch.full((count,), 0.5),
    )


def test_the_graph_has_the_relation_that_lasts_longest_and_at_least_one_second():
    """Steps of .2 s: follow for 1 s; yield for 1.2 s beats follow for 1 s; cut-in for .8 s is too short; a tie."""
    steps = 12
    types = torch.zeros(1, steps, 4, dtype=torch.long)
    types[0, :5, 0] = FOLLOW
    types[0, :5, 1], types[0, 5:11, 1] = FOLLOW, YIELD
    types[0, :4, 2] = CUT_IN
    types[0, :5, 3], types[0, 5:10, 3] = YIELD, FOLLOW
    assert summary_graph(types, 0.2).tolist() == [[FOLLOW, YIELD, NONE, FOLLOW]]


def test_a_vehicle_can_be_left_out():
    whole = scenes()
    part = whole.without(LAG)
    assert part.roles == (MERGER, LEADER)
    assert torch.equal(part.state, whole.state[:, [0, 2]])
    order = role_pairs(whole.roles)
    for edge, pair in enumerate(role_pairs(part.roles)):
        assert torch.equal(part.relations[..., edge], whole.relations[..., order.index(pair)])


def test_selected_and_joined_scenes_are_the_same_again():
    whole = scenes(3)
    again = joined([whole[torch.tensor([0])], whole[torch.tensor([1, 2])]])
    assert torch.equal(again.state, whole.state)
    assert torch.equal(again.relations, whole.relations)
    assert again.kind == whole.kind


def test_pairs_into_the_leader_are_not_scored():
    roles = (MERGER, LAG, LEADER)
    named = [role_pairs(roles)[edge] for edge in pairs_that_may_react(roles)]
    assert named == [(MERGER, LAG), (LAG, MERGER), (LEADER, MERGER), (LEADER, LAG)]
    assert [role_pairs(roles)[edge] for edge in pairs_of_merger(roles)] == named[:3]


def test_short_interruptions_are_filled_and_long_ones_and_other_relations_are_kept():
    types = torch.tensor([1, 1, 0, 0, 1, 1, 0, 0, 0, 0, 0, 1, 2, 0, 2, 0, 0])[None, :, None]
    wanted = torch.tensor([1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 1, 2, 2, 2, 0, 0])[None, :, None]
    assert torch.equal(close_gaps(types, 4), wanted)


def test_no_type_has_more_than_its_share_of_scored_steps_and_no_other_step_is_lost():
    generator = torch.Generator().manual_seed(1)
    types = (torch.rand(50, 30, 2, generator=generator) < torch.tensor([0.1, 0.7])).long()
    scored = balanced_steps(types, [0, 1], first=5, most=0.55, seed=0)
    assert not scored[:, :5].any()
    for edge in range(2):
        chosen = types[..., edge][scored[..., edge]]
        assert max(shares(chosen)) <= 0.5501
        rare = types[:, 5:, edge] == types[:, 5:, edge].flatten().bincount().argmin()
        assert scored[:, 5:, edge][rare].all()
    assert torch.equal(scored, balanced_steps(types, [0, 1], first=5, most=0.55, seed=0))


def test_a_pair_that_never_reacts_has_no_scored_step():
    assert not balanced_steps(torch.zeros(4, 9, 1, dtype=torch.long), [0], 2, 0.55, 0).any()
