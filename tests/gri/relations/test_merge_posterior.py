"""The posterior of merges on drivers of its own form: it finds relations, and says nothing where nobody reacts."""

import pytest
import torch

from gri.core.edges import LANE_CHANGING, EdgeType, pairs
from gri.relations.merge_explanations import ALL_TERMS, CONSTANTS
from gri.relations.merge_motion import lane_numbers, motion_of
from gri.relations.merge_posterior import learn_constants, relations, relations_per_step

DT, WIDTH, STEPS, CHANGE = 0.2, 3.5, 40, 20
TRUE = CONSTANTS | {"braking": 3.5, "relaxation": 0.2, "acceleration": 1.9, "slack": 0.2, "follow_noise": 0.15}
TRUE |= {"keep_noise": 0.1}
NONE, FOLLOW, YIELD, CUT_IN = (
    LANE_CHANGING.index(kind) for kind in (EdgeType.NONE, EdgeType.FOLLOW, EdgeType.YIELD, EdgeType.CUT_IN)
)


def edge(i: int, j: int) -> int:
    return pairs(3).index((i, j))


def gipps(x, v, leader, headway):
    """Acceleration of a driver behind `leader`: (x, v) of it, or None if the road is free."""
    if leader is None:
        return 1.7
    gap = leader[0] - x - 5.0 - 2.0
    reach = 3.5 * headway
    safe = max(reach**2 + leader[1] ** 2 + 7.0 * gap, 0.01) ** 0.5 - reach
    return min(max((safe - v) / 0.2, -3.5), 1.9) - 0.2


def merge_scenes(count: int, changes: bool = True, seed: int = 0, reacts: bool = True) -> torch.Tensor:
    """States [S, 3, T, 4] of merges: 0 keeps its speed and then follows 2, 1 follows 2 and then 0, 2 wavers.

    Without `reacts`, 1 follows a leader that is not in the scene.
    """
    rng = torch.Generator().manual_seed(seed)
    scenes = []
    for _ in range(count):
        noise = 0.15 * torch.randn(3, STEPS, generator=rng).double()
        headway, u = 1.0 + 0.6 * torch.rand(3, generator=rng), torch.rand(5, generator=rng)
        speed = 8 + 6 * float(u[0])
        x = [0.0, -14.0 - 8 * float(u[1]), 16.0 + 8 * float(u[2])]
        v = [speed] * 3
        wave, hidden = 0.25 + 0.3 * float(u[3]), [30.0 + x[1], speed]
        rows = []
        for t in range(STEPS):
            y = [-WIDTH, 0.0, 0.0]
            if changes and t >= CHANGE:
                s = min((t - CHANGE + 1) / 15, 1.0)
                y[0] += WIDTH * s**3 * (10 - 15 * s + 6 * s**2)
            rows.append([[x[k], y[k], v[k], 0.0] for k in range(3)])
            merged = changes and t >= CHANGE
            leader = hidden if not reacts else [x[0], v[0]] if merged else [x[2], v[2]]
            a = [
                gipps(x[0], v[0], [x[2], v[2]], float(headway[0])) if merged else 0.0,
                gipps(x[1], v[1], leader, float(headway[1])),
                float(torch.sin(torch.tensor(wave * t + 6 * float(u[4])))),
            ]
            a = [a[k] + float(noise[k, t]) for k in range(3)]
            hidden = [hidden[0] + hidden[1] * DT, hidden[1] + DT * float(torch.sin(torch.tensor(0.4 * t)))]
            for k in range(3):
                new = max(v[k] + a[k] * DT, 0.0)
                x[k], v[k] = x[k] + (v[k] + new) / 2 * DT, new
        scenes.append(rows)
    return torch.tensor(scenes, dtype=torch.float64).transpose(1, 2)


@pytest.fixture(scope="module")
def merges():
    return merge_scenes(12)


def test_a_lane_change_counts_from_its_beginning(merges):
    lane = lane_numbers(merges[..., 1], WIDTH)
    assert (lane[:, 0, :CHANGE] == -1).all()
    assert (lane[:, 0, CHANGE:] == 0).all()
    noisy = merges[..., 1] + 0.03 * torch.randn(merges.shape[:3], generator=torch.Generator().manual_seed(1))
    begin = (lane_numbers(noisy, WIDTH)[:, 0] == 0).int().argmax(-1)
    assert (begin - CHANGE).abs().max() <= 3


def test_a_lane_change_that_goes_on_is_seen_before_the_line_is_crossed(merges):
    y = merges[..., 1]
    for last in range(3, STEPS):
        seen = lane_numbers(y[..., : last + 1], WIDTH, unfinished=True)
        begin = torch.where((seen[:, 0] == 0).any(-1), (seen[:, 0] == 0).int().argmax(-1), STEPS)
        if last < CHANGE:
            assert (begin == STEPS).all()
        else:  # from its first step on, in which it has moved by a centimetre; the line is crossed 7 steps later
            assert (begin - CHANGE).abs().max() <= 1
        assert (lane_numbers(y[..., : last + 1], WIDTH)[:, 0] == 0).any() == (last >= CHANGE + 7)


def test_who_wavers_in_its_lane_does_not_change_it(merges):
    y = merges[..., 1].clone()
    y[:, 0] = -WIDTH + 0.15 * torch.sin(0.5 * torch.arange(STEPS, dtype=y.dtype))
    for last in range(3, STEPS):
        assert (lane_numbers(y[..., : last + 1], WIDTH, unfinished=True)[:, 0] == -1).all()


def test_where_all_vehicles_waver_a_change_is_seen_later(merges):
    noisy = merges[..., 1] + 0.05 * torch.randn(merges.shape[:3], generator=torch.Generator().manual_seed(2)).double()
    begun = []
    for last in range(8, STEPS):
        seen = lane_numbers(noisy[..., : last + 1], WIDTH, unfinished=True)
        begun.append((seen[:, 0, -1] == 0).double().mean())
        assert last >= CHANGE or begun[-1] <= 0.2
    assert min(begun[CHANGE + 7 - 8 :]) == 1  # the line is crossed
    assert sum(begun[: CHANGE - 8]) / (CHANGE - 8) < 0.03


def test_a_change_that_goes_on_is_a_cut_in_for_who_will_have_to_brake(merges):
    last = CHANGE + 3  # a cut-in lasts 1 s from the first lateral motion on
    near = merges[:, :, : last + 1].clone()
    near[:, 1, :, 0] += near[:, 0, -1:, 0] - 10.0 - near[:, 1, -1:, 0]
    far = near.clone()
    far[:, 1, :, 0] -= 60.0
    for state, least, most in ((near, 0.9, 1.1), (far, 0.0, 0.1)):
        found = relations(motion_of(state, WIDTH, DT, unfinished=True), TRUE, unfinished=True)
        assert least <= found[:, -1, edge(1, 0), CUT_IN].min()
        assert found[:, -1, edge(1, 0), CUT_IN].max() <= most
    assert relations(motion_of(near, WIDTH, DT), TRUE)[:, -1, edge(1, 0), CUT_IN].max() == 0


def test_it_finds_who_is_followed_before_and_after_the_change(merges):
    found = relations_per_step(merges, WIDTH, DT, constants=TRUE)
    assert torch.allclose(found.sum(-1), torch.ones_like(found[..., 0]))
    assert found[:, 5 : CHANGE - 1, edge(2, 1), FOLLOW].mean() > 0.5
    assert found[:, CHANGE + 3 : -1, edge(0, 1), FOLLOW].mean() > 0.8
    assert found[:, CHANGE:, edge(2, 1), FOLLOW].max() < 0.01  # the merging vehicle is in between
    assert found[:, :, edge(1, 2)].argmax(-1).max() == NONE  # 1 is behind 2


def test_a_lag_vehicle_that_reacts_to_nobody_here_is_left_alone(merges):
    real = relations_per_step(merges, WIDTH, DT, constants=TRUE)
    alone = relations_per_step(merge_scenes(12, reacts=False), WIDTH, DT, constants=TRUE)
    follows = [found[:, 5:-1, [edge(2, 1), edge(0, 1)], FOLLOW].sum(-1).mean() for found in (real, alone)]
    assert follows[0] > 0.8
    assert follows[1] < 0.1


def test_who_keeps_its_lane_neither_cuts_in_nor_is_followed_from_there(merges):
    kept = merges.clone()
    kept[:, 0, :, 1] = -WIDTH
    found = relations_per_step(kept, WIDTH, DT, constants=TRUE)
    assert found[:, :, edge(1, 0), CUT_IN].max() == 0
    assert found[:, :, edge(0, 1), FOLLOW].max() < 0.01


def test_origin_and_width_of_lanes_do_not_matter(merges):
    moved = merges.clone()
    moved[..., 0] += 1234.5
    moved[..., 1] = 17 + 1.2 * moved[..., 1]
    here, there = relations_per_step(merges, WIDTH, DT), relations_per_step(moved, 1.2 * WIDTH, DT)
    assert torch.allclose(here, there, atol=1e-6)


@pytest.mark.slow
def test_constants_are_learned_without_labels_from_wrong_ones(merges):
    motion = motion_of(merge_scenes(10, seed=5), WIDTH, DT)
    wrong = TRUE | {"braking": 7.0, "relaxation": 0.4, "follow_noise": 0.3}
    found, evidence = learn_constants(motion, wrong, ALL_TERMS, updates=40, batch=4)
    assert abs(found["braking"] - 3.5) < 0.6
    assert abs(found["relaxation"] - 0.2) < 0.08
    with_wrong = learn_constants(motion, wrong, ALL_TERMS, updates=0)[1]
    assert evidence > with_wrong + 0.1
    p = relations(motion_of(merges, WIDTH, DT), found)
    assert p[:, CHANGE + 3 : -1, edge(0, 1), FOLLOW].mean() > 0.8


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_what_is_not_finite_is_an_error_and_never_none(merges, bad):
    state = merges[:2].clone()
    state[1, 0, 3, 2] = bad
    with pytest.raises(ValueError, match="not finite"):
        relations_per_step(state, WIDTH, DT)


def test_too_short_a_history_is_an_error(merges):
    with pytest.raises(ValueError, match="got 2 steps, wanted at least 3"):
        relations_per_step(merges[:2, :, :2], WIDTH, DT)
