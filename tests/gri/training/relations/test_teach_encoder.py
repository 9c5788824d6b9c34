"""Counterfactual teaching: broken relations end, and the encoder learns what a constant cannot know."""

import torch

from gri.networks.pair_encoder import PairEncoder, PairEncoderConfig
from gri.relations.reaction_scenes import OWN, UNSEEN, ReactionPrior, Reactions, draw_reactions
from gri.training.relations.teach_encoder import (
    TeachingSettings,
    broken_batch,
    explanation_loss,
    hide_vehicles,
    teach_encoder,
    with_strangers,
)

SMALL = TeachingSettings(scenes=1500, updates=120, batch=64, window=(25, 25), vehicles=(3, 3))


def chain(scenes: int = 6, vehicles: int = 4, steps: int = 5) -> Reactions:
    x = 20.0 * torch.arange(vehicles)[None, :, None] + torch.arange(steps) + 0.01 * torch.arange(scenes)[:, None, None]
    v = torch.full((scenes, vehicles, steps), 5.0) + torch.arange(scenes)[:, None, None]
    leader = torch.tensor([1, 2, 3, OWN]).expand(scenes, vehicles)
    return Reactions(x.expand(scenes, vehicles, steps).clone(), v, leader)


def test_hidden_leaders_are_unseen_and_others_are_renumbered(generator: torch.Generator):
    for _ in range(20):
        shown = hide_vehicles(chain(), 3, generator)
        assert shown.x.shape == (6, 3, 5)
        place = (shown.x[:, :, 0] / 20).round().long()
        for scene in range(6):
            for j in range(3):
                true = int(place[scene, j]) + 1
                wanted = OWN if true == 4 else (place[scene].tolist().index(true) if true in place[scene] else UNSEEN)
                assert int(shown.leader[scene, j]) == wanted


def test_relations_end_where_strangers_begin(generator: torch.Generator):
    scenes = chain()
    assert torch.equal(with_strangers(scenes, 0.0, generator).leader, scenes.leader)
    mixed = with_strangers(scenes, 1.0, generator)
    same_as_first = mixed.v[:, :, 0] == mixed.v[:, :1, 0]
    for scene in range(len(mixed)):
        for j, k in ((0, 1), (1, 2), (2, 3)):
            together = bool(same_as_first[scene, j] == same_as_first[scene, k])
            assert int(mixed.leader[scene, j]) == (k if together else UNSEEN)
    torch.testing.assert_close(mixed.x[:, :, 0], scenes.x[: len(mixed), :, 0])


def test_batches_show_what_would_be_measured(generator: torch.Generator):
    pool = draw_reactions(ReactionPrior(), 1000, 61, 0.2, generator)
    batch = broken_batch(pool, SMALL, generator)
    assert batch.x.shape[1:] == (3, 25)
    assert 32 < len(batch) <= 64


def test_the_encoder_learns_more_than_how_often_each_explanation_holds():
    torch.manual_seed(0)
    encoder = PairEncoder(PairEncoderConfig(hidden=16), 1, 0.2)
    generator = torch.Generator().manual_seed(7)
    fresh = draw_reactions(ReactionPrior(), 2000, 25, 0.2, generator)
    held_out = hide_vehicles(fresh, 3, generator)
    target = torch.where(
        held_out.leader[:, 0] >= 0, held_out.leader[:, 0] + 1, (held_out.leader[:, 0] == UNSEEN).long()
    )
    share = torch.bincount(target).double() / len(target)
    constant = float(-(share * share.log()).sum())
    with torch.no_grad():
        before = float(explanation_loss(encoder, held_out))
    teach_encoder(encoder, SMALL, 0)
    with torch.no_grad():
        after = float(explanation_loss(encoder, held_out))
    assert after < 0.95 * min(before, constant)
