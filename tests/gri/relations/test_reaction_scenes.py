"""Drawn reactions: what is drawn is what moves, and nothing else tells the relation."""

import torch

from gri.relations.reaction_scenes import OWN, UNSEEN, ReactionPrior, draw_reactions

CALM = ReactionPrior(action_noise=(1e-4, 2e-4), perception_noise=(1e-5, 2e-5), settle=(0.0,))


def test_scenes_have_no_contact_and_their_states_fit(generator: torch.Generator):
    scenes = draw_reactions(ReactionPrior(), 500, 41, 0.2, generator)
    assert 100 < len(scenes) < 500
    assert float((scenes.x[:, 1:] - scenes.x[:, :-1]).min()) > 5.0
    assert float(scenes.v.min()) >= 0.0
    moved = scenes.x[..., 1:] - scenes.x[..., :-1]
    assert float((moved - 0.1 * (scenes.v[..., 1:] + scenes.v[..., :-1])).abs().max()) < 0.1


def test_the_same_seed_gives_the_same_scenes():
    first, second = (draw_reactions(CALM, 100, 21, 0.2, torch.Generator().manual_seed(4)) for _ in range(2))
    assert torch.equal(first.x, second.x)
    assert torch.equal(first.leader, second.leader)


def test_leaders_are_ahead_and_the_foremost_vehicle_has_none(generator: torch.Generator):
    leader = draw_reactions(CALM, 2000, 15, 0.2, generator).leader
    assert set(leader[:, -1].tolist()) == {OWN, UNSEEN}
    follows = leader >= 0
    assert bool((leader > torch.arange(5))[follows].all())


def test_first_headways_do_not_tell_the_relation(generator: torch.Generator):
    prior = ReactionPrior(settle=(0.0,), headway=(60.0, 400.0), reach=(900.0, 901.0))  # without contacts, which select
    scenes = draw_reactions(prior, 6000, 15, 0.2, generator)
    headway = (scenes.x[:, 1, 0] - scenes.x[:, 0, 0]).log()
    follows = scenes.leader[:, 0] == 1
    difference = headway[follows].mean() - headway[~follows].mean()
    assert abs(float(difference)) < 4 * float(headway.std()) * (1 / follows.sum() + 1 / (~follows).sum()) ** 0.5


def test_a_follower_reacts_to_its_leader_and_a_vehicle_with_its_own_speed_does_not(generator: torch.Generator):
    scenes = draw_reactions(CALM, 4000, 61, 0.2, generator)
    v = scenes.v[:, 0, 10:] - scenes.v[:, 0, 10:].mean(-1, keepdim=True)
    w = scenes.v[:, 1, :-10] - scenes.v[:, 1, :-10].mean(-1, keepdim=True)
    covariance = (v * w).mean(-1) / (v.std(-1) * w.std(-1)).clamp(min=1e-3)
    moving = scenes.v[:, 1].std(-1) > 0.5
    near = scenes.x[:, 1, 0] - scenes.x[:, 0, 0] < 40
    follows = (scenes.leader[:, 0] == 1) & moving & near
    alone = (scenes.leader[:, 0] == OWN) & moving & near
    assert float(covariance[follows].mean()) > float(covariance[alone].mean()) + 0.2
