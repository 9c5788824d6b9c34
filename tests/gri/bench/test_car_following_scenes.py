"""Scenes with known relations: what is independent of what, and that followers do react."""

from dataclasses import replace

import torch

from gri.bench.car_following_scenes import OWN, UNSEEN, SceneFamily, draw_scenes
from gri.bench.driver_models import DRIVER_MODELS, IDM, LINEAR
from gri.core.edges import pairs

NEAR = SceneFamily("near", headway=(10.0, 50.0))


def test_the_same_seed_gives_the_same_scenes():
    one, two, other = (draw_scenes(NEAR, IDM, 40, seed) for seed in (1, 1, 2))
    assert torch.equal(one.state, two.state)
    assert torch.equal(one.leader, two.leader)
    assert not torch.equal(one.state, other.state)


def test_nobody_touches_and_states_move_as_they_say():
    for model in DRIVER_MODELS:
        known = draw_scenes(NEAR, model, 60, 3)
        x, v, _ = known.state.unbind(-1)
        assert ((x[:, 1:] - x[:, :-1]) > 5.3).all()
        assert (v >= 0).all()
        # Two substeps of constant acceleration: the position lies within what both end speeds allow.
        moved = (x[..., 1:] - x[..., :-1]) / NEAR.dt
        assert (moved - (v[..., 1:] + v[..., :-1]) / 2).abs().max() < 8.0 * NEAR.dt / 4 + 1e-9


def test_at_most_one_of_those_ahead_is_followed_and_the_graph_says_so():
    known = draw_scenes(replace(NEAR, vehicles=4), IDM, 200, 4)
    leader, graph = known.leader, known.graph()
    assert ((leader == OWN) | (leader == UNSEEN) | (leader > torch.arange(4))).all()
    assert (leader[:, 3] < 0).all()
    for edge, (i, j) in enumerate(pairs(4)):
        assert torch.equal(graph[:, edge] == 1, leader[:, j] == i)


def test_starts_are_drawn_independently_of_the_graph():
    """With the same seed, graphs that differ leave all first positions and speeds as they are."""
    nobody = draw_scenes(replace(NEAR, follows=0.0, headway=(60.0, 61.0)), LINEAR, 100, 5)
    everybody = draw_scenes(replace(NEAR, follows=1.0, headway=(60.0, 61.0)), LINEAR, 100, 5)
    assert (nobody.leader < 0).all()
    assert (everybody.leader[:, :2] > 0).all()
    if nobody.acceptance == everybody.acceptance == 1.0:
        assert torch.equal(nobody.state[:, :, 0], everybody.state[:, :, 0])
    kept = draw_scenes(NEAR, LINEAR, 1500, 6)
    headway = kept.state[:, 1, 0, 0] - kept.state[:, 0, 0, 0]
    follows = kept.leader[:, 0] == 1
    # What is left is that scenes with a contact are thrown away, more of them where nobody follows.
    assert abs(headway[follows].mean() - headway[~follows].mean()) < 3.0


def test_a_follower_answers_its_leader_and_nobody_else():
    """Correlation of speeds over the window: with the vehicle followed high, with a stranger low."""
    quiet = replace(NEAR, action_noise=0.02, perception_noise=0.0)
    known = draw_scenes(quiet, LINEAR, 600, 7)
    v = known.state[..., 1]
    change = v[:, :, 30:] - v[:, :, :-30]
    a, b = (change[:, j] - change[:, j].mean(-1, keepdim=True) for j in (0, 1))
    correlation = (a * b).sum(-1) / ((a**2).sum(-1) * (b**2).sum(-1)).sqrt()
    follows = known.leader[:, 0] == 1
    assert correlation[follows].mean() > correlation[~follows].mean() + 0.2


def test_selected_scenes_show_as_many_states_as_all():
    known = replace(draw_scenes(NEAR, IDM, 4, 1), shown=12)
    assert known[:2].shown == 12
    assert len(known[:2]) == 2
