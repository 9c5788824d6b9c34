"""Rows: what they are given, what the structured prior does, and that none answers where nothing can be known."""

from dataclasses import replace

import msgspec
import pytest
import torch

from gri.bench import reconstruction_rows, resumable_jobs, reward_rows
from gri.bench.answers import ask
from gri.bench.car_following_scenes import KnownScenes, SceneFamily, draw_scenes
from gri.bench.driver_models import IDM, LINEAR, DriverModel
from gri.bench.families import NEAR, split
from gri.bench.relations import Plan, mark, run
from gri.bench.rows import ROWS
from gri.bench.scores import auc
from gri.bench.structure import FLAT, share_among_those_ahead, with_prior
from gri.core.edges import pairs
from gri.errors import InputError


@pytest.fixture(scope="module")
def train() -> tuple[KnownScenes, ...]:
    return (split("train", IDM, NEAR, 30), split("train", LINEAR, NEAR, 30))


@pytest.fixture(scope="module")
def own_drivers() -> KnownScenes:
    """Drivers close to the constants of the reward: they want to be 7 m + 1.42 s behind, front to front, or 29 m/s."""
    fixed = {"k0": 0.15, "k1": 0.15, "k2": 0.6, "T": 1.42, "s0": 2.0}
    model = DriverModel("near the reward", "", {name: (v, v) for name, v in fixed.items()}, LINEAR.acceleration)
    family = SceneFamily(
        "calm", headway=(25.0, 45.0), speed=(14.0, 20.0), delay=(0.0, 0.0), perception_noise=0.0, action_noise=0.02,
        wished_surplus=(9.0, 13.0), unseen=0.0,
    )  # fmt: skip
    return draw_scenes(family, model, 100, 5)


def test_names_of_rows_are_different():
    assert len({row.name for row in ROWS}) == len(ROWS)


def test_the_structured_prior_without_motion_is_the_row_of_that_name():
    (prior,) = (row for row in ROWS if row.name == "prior alone")
    known = split("test", IDM, NEAR, 3)
    flat = with_prior(lambda scenes: torch.full((len(scenes), 6), FLAT, dtype=torch.float64))
    assert torch.allclose(ask(flat, known).follow, ask(prior.prepare([], [], 0), known).follow)


def test_the_structured_prior_has_one_leader_ahead():
    """Even odds between nobody and the leaders, so that two ratios r and 1 give r/2 : 1/2 : 1 · 1/2 · 2."""
    ratio = torch.tensor([[3.0, 3.0, 0.0, 3.0, 0.0, 0.0]], dtype=torch.float64)  # pairs 01 02 10 12 20 21
    ratio[0, 2], ratio[0, 4] = torch.tensor(4.0).log(), 0.0
    found = dict(zip(pairs(3), share_among_those_ahead(ratio)[0].tolist(), strict=True))
    assert found[1, 0] == pytest.approx(4 / (4 + 1 + 2))
    assert found[2, 0] == pytest.approx(1 / (4 + 1 + 2))
    assert found[2, 1] == pytest.approx(1 / 2)
    assert found[0, 1] == found[0, 2] == found[1, 2] == 0


@pytest.mark.parametrize("structured", [False, True])
def test_the_untrained_reward_ranks_the_relations_of_its_own_drivers(own_drivers, structured):
    """With leaders of other scenes in the place of the true ones it knows nothing any more."""
    infer = reward_rows.untrained_reward(structured)
    marked = mark(infer, own_drivers)
    assert auc(marked.p, marked.truth) > 0.75
    mixed = own_drivers.state.clone()
    mixed[:, 1:] = mixed[:, 1:].roll(1, 0)
    mixed[..., 0] += own_drivers.state[:, :, :1, 0] - mixed[:, :, :1, 0]
    broken = mark(infer, replace(own_drivers, state=mixed))
    assert auc(broken.p, broken.truth) < auc(marked.p, marked.truth) - 0.1


def test_the_point_mass_moves_through_its_scenes():
    """States, actions and dynamics belong together: one step from each state comes near the next one."""
    known = split("test", IDM, NEAR, 20)
    scenes, model = reward_rows.point_mass_scenes(known), reward_rows.new_model(0)
    driven = scenes.state[:, :-1]
    moved = model.step(driven[:, :, :-1], scenes.action)
    assert (moved - driven[:, :, 1:]).abs()[..., :2].max() < 0.1
    headway = known.state[:, 1:, :30, 0] - known.state[:, :-1, :30, 0]
    assert torch.allclose(scenes.state[:, 1:, :, 0] - scenes.state[:, :-1, :, 0], headway.float(), atol=1e-3)
    assert scenes.graph.sum() == 0


def test_rows_without_labels_do_not_see_relations(train, monkeypatch):
    """Another truth for the training scenes changes no answer."""
    few = msgspec.structs.replace(reward_rows.SETTINGS, reward_updates=3, encoder_lead=3)
    monkeypatch.setattr(reward_rows, "SETTINGS", few)
    monkeypatch.setattr(reconstruction_rows, "NRI", msgspec.structs.replace(reconstruction_rows.NRI, updates=3))
    monkeypatch.setattr(reconstruction_rows, "PER_STEP_UPDATES", 3)
    other = tuple(replace(known, leader=known.leader.flip(0)) for known in train)
    test = split("test", LINEAR, NEAR, 10)
    for name in ("NRI", "NRI per step (as dNRI)", "GRI, reward", "GRI, reward + prior", "GRI, encoder", "closed form"):
        (row,) = (row for row in ROWS if row.name == name)
        assert row.given.startswith("no labels")
        first, second = (ask(row.prepare(scenes, [], 0), test).follow for scenes in (train, other))
        assert torch.equal(first, second), name
        if name.endswith("+ prior"):
            behind = [edge for edge, (i, j) in enumerate(pairs(3)) if i < j]
            assert first[:, behind].max() == 0


@pytest.mark.parametrize("name", [row.name for row in ROWS if row.name.startswith("released") or row.name == "PCMCI"])
@pytest.mark.parametrize("spoil", ["nan", "short"])
def test_nothing_is_inferred_from_scenes_that_were_not_seen(name, spoil):
    (row,) = (row for row in ROWS if row.name == name)
    known = split("test", IDM, NEAR, 4)
    state = known.state.clone()
    state[1, 0, 3, 1] = float("nan")
    spoiled = replace(known, state=state if spoil == "nan" else known.state[:, :, :30])
    infer = row.prepare([], [known, known], 0) if row.needs is None else (lambda _: torch.zeros(4, 6))
    with pytest.raises(InputError, match="1 scenes with states that are not finite" if spoil == "nan" else "30 states"):
        ask(infer, spoiled)


def test_a_row_without_its_module_is_left_out_and_the_page_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(resumable_jobs, "find_spec", lambda _: None)
    assert [row.name for row in resumable_jobs.left_out(ROWS)] == ["PCMCI"]
    assert "PCMCI" not in [row.name for row, _ in Plan(tmp_path).jobs()]
    with pytest.raises(InputError, match="tigramite is not installed; pip install 'gri-cosim"):
        run(Plan(tmp_path, rows=("PCMCI",)))


def test_pcmci_finds_who_copies_whom():
    pytest.importorskip("tigramite")
    from gri.bench.pcmci_row import pcmci

    generator = torch.Generator().manual_seed(0)
    a = torch.randn((2, 3, 60), generator=generator, dtype=torch.float64)
    a[:, 0, 2:] = 0.9 * a[:, 1, :-2] + 0.3 * a[:, 0, 2:]  # vehicle 0 copies vehicle 1 two steps later
    v = 20 + 0.2 * torch.nn.functional.pad(a.cumsum(-1), (1, 0))
    known = KnownScenes(torch.stack([v, v, v], -1), torch.full((2, 3), -1), 1.0)
    found = pcmci(known)
    every = pairs(3)
    assert (found[:, every.index((1, 0))] > 5).all()
    assert (found[:, every.index((1, 0))] > found[:, every.index((2, 0))] + 2).all()
    assert found[:, [edge for edge, (i, j) in enumerate(every) if i < j]].sum() == 0
