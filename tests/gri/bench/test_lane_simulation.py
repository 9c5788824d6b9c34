"""Simulated merges: a relation is there where it moves a vehicle, and nowhere else."""

from dataclasses import replace

import pytest
import torch

from gri.bench.driver_models import DRIVER_MODELS, IDM, KRAUSS
from gri.bench.lane_families import LANES, strangers
from gri.bench.lane_scenes import CUT_IN, FOLLOW, NONE, YIELD, LaneScenes
from gri.bench.lane_simulation import KINDS, LaneFamily, _simulate, draw_lane_scenes
from gri.core.edges import pairs

MERGE, REFUSED, CHANGE, KEEPER = KINDS
EDGE = {pair: edge for edge, pair in enumerate(pairs(3))}


def simulated(family: LaneFamily, kind: str, count: int = 60, seed: int = 5) -> LaneScenes:
    """All drawn scenes, also those with a contact, so that scenes of two families can be paired."""
    generator = torch.Generator().manual_seed(seed)
    return _simulate(family, IDM, torch.full((count,), KINDS.index(kind)), generator)[0]


@pytest.fixture(scope="module")
def drawn() -> dict[str, LaneScenes]:
    return {kind: draw_lane_scenes(LANES, IDM, {kind: 60}, seed=3) for kind in KINDS}


def test_the_same_seed_gives_the_same_scenes():
    one, two, other = (draw_lane_scenes(LANES, KRAUSS, {MERGE: 12, KEEPER: 4}, seed) for seed in (1, 1, 2))
    assert torch.equal(one.state, two.state)
    assert torch.equal(one.relations, two.relations)
    assert not torch.equal(one.state, other.state)
    assert one.kind == (MERGE,) * 12 + (KEEPER,) * 4


def test_who_changes_lanes(drawn):
    final = {kind: scenes.state[:, 0, -1, 1] / scenes.lane_width for kind, scenes in drawn.items()}
    assert (final[MERGE] > -0.5).double().mean() > 0.6
    assert (final[KEEPER] < -0.7).all()
    for scenes in drawn.values():
        assert (scenes.state[:, 1:, :, 1].abs() < 1.2).all()
        assert (scenes.state[:, 0, 0, 1] / scenes.lane_width < -0.7).all()


def test_the_state_moves_as_it_says(drawn):
    for scenes in drawn.values():
        x, y, v, heading = (scenes.state[..., d] for d in range(4))
        dx, dy = x[..., 1:] - x[..., :-1], y[..., 1:] - y[..., :-1]
        assert (dx / 0.2 - (v[..., 1:] + v[..., :-1]) / 2).abs().max() < 8.0 * 0.2 / 4 + 1e-9
        moving = dx > 0.1
        assert torch.allclose(dy[moving], (dx * heading[..., :-1].tan())[moving], atol=1e-9)
        assert (dy[dx == 0].abs() < 0.02).all()


def test_relations_of_each_kind(drawn):
    found = {
        kind: {pair: set(scenes.relations[..., edge].unique().tolist()) for pair, edge in EDGE.items()}
        for kind, scenes in drawn.items()
    }
    for kind in KINDS:
        assert found[kind][0, 2] == found[kind][1, 2] == {NONE}
    for kind in (CHANGE, KEEPER):
        assert found[kind][0, 1] == found[kind][1, 0] == found[kind][2, 0] == {NONE}
    assert found[MERGE][0, 1] == {NONE, FOLLOW, YIELD}
    assert found[MERGE][1, 0] == {NONE, CUT_IN}
    assert found[MERGE][2, 0] == {NONE, FOLLOW}
    assert found[REFUSED][0, 1] == {NONE}
    assert YIELD in found[REFUSED][1, 0]
    assert CUT_IN not in found[REFUSED][1, 0]


def test_yielding_slows_the_lag_vehicle_and_only_from_its_label_on():
    family = replace(LANES, reacts=1.0)
    polite, rude = (simulated(replace(family, yields=share), MERGE) for share in (1.0, 0.0))
    assert torch.equal(polite.state[:, :, 0, :3], rude.state[:, :, 0, :3])
    labelled = polite.relations[..., EDGE[0, 1]] == YIELD
    assert not (rude.relations[..., EDGE[0, 1]] == YIELD).any()
    slower = rude.state[:, 1, :, 2] - polite.state[:, 1, :, 2]
    first = torch.where(labelled.any(1), labelled.double().argmax(1), labelled.shape[1])
    before = torch.arange(labelled.shape[1]) <= first[:, None]
    assert slower[before].abs().max() < 0.2  # effects below the threshold add up
    late = labelled.sum(1) > 10
    assert slower[late].amax(1).mean() > 2.0


def test_a_merger_that_adapts_moves_otherwise_and_is_labelled():
    adapting, not_adapting = (simulated(replace(LANES, adapts=share), MERGE) for share in (1.0, 0.0))
    outside = adapting.state[:, 0, :, 1] < -0.85 * adapting.lane_width[:, None]
    follows = adapting.relations[..., EDGE[2, 0]] == FOLLOW
    assert (follows & outside).double().sum() > 500
    assert not ((not_adapting.relations[..., EDGE[2, 0]] == FOLLOW) & outside).any()


def test_without_a_reaction_of_the_lag_vehicle_nobody_cuts_in():
    scenes = simulated(replace(LANES, reacts=0.0), MERGE)
    assert (scenes.relations[..., EDGE[1, 0]] == NONE).all()
    assert (scenes.relations[..., EDGE[0, 1]] == NONE).all()
    scenes = simulated(replace(LANES, reacts=1.0), MERGE)
    cut_in = scenes.relations[..., EDGE[1, 0]] == CUT_IN
    in_lane = scenes.state[:, 0, :, 1] > -0.3 * scenes.lane_width[:, None]
    braked = (scenes.state[:, 1, 1:, 2] < scenes.state[:, 1, :-1, 2] - 0.02).any(1)
    assert 0.3 < cut_in.any(1).double().mean() < 1.0
    assert braked[cut_in.any(1)].double().mean() > 0.95
    assert not (cut_in & in_lane)[:, -1].all()


@pytest.mark.parametrize("kind", [CHANGE, KEEPER])
def test_where_nobody_reacts_no_vehicle_knows_where_the_merger_is(kind):
    near, far = (simulated(replace(LANES, place=(place, place)), kind) for place in (0.3, 0.6))
    assert not torch.equal(near.state[:, 0, :, 0], far.state[:, 0, :, 0])
    assert torch.allclose(near.state[..., 2], far.state[..., 2], atol=1e-6)


def test_a_waiting_merger_lets_the_lag_vehicle_pass():
    scenes = simulated(replace(LANES, waits=1.0, wobble=0.0), REFUSED)
    waits = (scenes.relations[..., EDGE[1, 0]] == YIELD).sum(1) > 15
    ahead_of_lag = scenes.state[:, 0, :, 0] - scenes.state[:, 1, :, 0]
    assert waits.double().mean() > 0.4
    assert (ahead_of_lag[waits, -1] < ahead_of_lag[waits, 0]).double().mean() > 0.7
    follows = scenes.relations[..., EDGE[1, 0]] == FOLLOW
    assert (ahead_of_lag[follows] < 0).all()


@pytest.mark.parametrize("model", DRIVER_MODELS, ids=lambda model: model.name)
def test_no_two_vehicles_touch(model):
    scenes = draw_lane_scenes(LANES, model, {MERGE: 20, REFUSED: 20}, seed=4)
    x, y = scenes.state[..., 0], scenes.state[..., 1]
    for i, j in pairs(3):
        abreast = (y[:, i] - y[:, j]).abs() < 2.0
        assert ((x[:, i] - x[:, j]).abs()[abreast] >= 5.3).all()
    assert ((scenes.acceptance > 0.2) & (scenes.acceptance < 1)).all()


def test_strangers_have_their_own_motion_and_no_relation(drawn):
    mixed = strangers(drawn[MERGE], 30)
    assert 3 < len(mixed) <= 30
    assert (mixed.relations == NONE).all()
    speeds = drawn[MERGE].state[..., 2]
    for scene in mixed.state[:5]:
        sources = [int((speeds[:, vehicle] == scene[vehicle, :, 2]).all(-1).nonzero()[0, 0]) for vehicle in range(3)]
        assert len(set(sources)) == 3
    assert (mixed.state[..., 2].mean(-1).std(1) < 1.0).all()
