"""Test sets made of a scene file as `cosim scenes --kind triple --gold` writes it, with hand-made relations."""

from pathlib import Path

import numpy as np
import pytest

from gri.bench.sumo_relations import SumoPlan, card, run_sumo
from gri.bench.sumo_scenes import AHEAD, best_constant, matched_auc, read_sumo_file
from gri.core.edges import pairs
from gri.data.scene_file.schema import Header, SceneBlock, writing
from gri.errors import InputError

T, COUNT = 31, 12
FOLLOWS = [{(1, 0), (2, 1)}, {(2, 0)}, {(2, 1)}, set()]  # by scene modulo 4; (sender, receiver)
ORIGIN = {
    "gold": True,
    "kinds": ["triple"],
    "source": "hand_made",
    "count": 3 * COUNT,
    "per_seed": COUNT,
    "seeds": [1, 3],
    "rules": {},
    "scenario": {"traffic": {"vehicles": [{"car_following": "EIDM"}]}},
}


def block(part: str) -> SceneBlock:
    """Vehicles at 10 m/s, 20 m apart, 4 m and 6 m long; vehicle 1 of every other scene is in the lane beside."""
    time = 0.2 * np.arange(T)
    x = 20.0 * np.arange(3.0)[None, :, None] + 10.0 * time + np.arange(COUNT)[:, None, None]
    y = np.zeros((COUNT, 3, T))
    y[1::2, 1] = 3.5
    v, a = np.full_like(x, 10.0), np.zeros_like(x)
    edges = np.full((COUNT, 6, T), "none", object)
    for scene in range(COUNT):
        for edge, pair in enumerate(pairs(3)):
            if pair in FOLLOWS[scene % 4]:
                edges[scene, edge] = "follow"
    edges[0, pairs(3).index((1, 0)), 16:] = "none"  # 16 of 31 steps: still more than half
    edges[4, pairs(3).index((1, 0)), 12:] = "none"  # 12 of 31 steps: no longer
    return SceneBlock(
        kind="triple",
        source=np.full(COUNT, "hand_made", object),
        recording=np.full(COUNT, "seed 1", object),
        split=np.full(COUNT, part, object),
        start=np.zeros(COUNT),
        vehicle=np.arange(3 * COUNT).reshape(COUNT, 3),
        features={"x": x, "y": y, "vx": v, "v": v, "a": a, "ax": a},
        edges=edges[..., 0],
        size={"length": np.tile([4.0, 4.0, 6.0], (COUNT, 1)), "width": np.full((COUNT, 3), 1.8)},
        step_edges=edges,
        hypothesis=edges[..., 0],
        unambiguous=np.ones(COUNT, bool),
    )


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "scenes.parquet"
    with writing(path, Header(dt=0.2, provenance={"sumo": ORIGIN})) as write:
        for part in ("train", "validation", "test"):
            write(block(part))
    return path


def test_the_graph_is_what_holds_at_more_than_half_of_the_steps(file: Path):
    found = read_sumo_file(file)
    scenes = found.parts["test"]
    assert (found.drivers, found.scenario, len(scenes.known)) == ("EIDM", "hand_made", COUNT)
    assert scenes.known.leader[:4].tolist() == [[1, 2, -1], [2, -1, -1], [-1, 2, -1], [-1, -1, -1]]
    assert scenes.known.leader[4].tolist() == [-1, 2, -1]
    assert scenes.unambiguous.tolist() == [scene not in (0, 4) for scene in range(COUNT)]
    assert scenes.steps[0, AHEAD.index(pairs(3).index((1, 0)))].sum() == 16


def test_states_have_vehicles_of_five_metres_and_their_true_gaps(file: Path):
    state = read_sumo_file(file).parts["test"].known.state
    assert state[:, 0, 0, 0].abs().max() == 0
    gaps = state[0, 1:, 0, 0] - state[0, :-1, 0, 0] - 5.0
    assert gaps.tolist() == pytest.approx([16.0, 14.0])


def test_pairs_know_whether_they_share_a_lane(file: Path):
    same = read_sumo_file(file).parts["test"].same_lane
    assert same[0].all()
    assert [pairs(3)[AHEAD[k]] for k in np.flatnonzero(same[1])] == [(2, 0)]


def test_the_best_constant_is_the_best_of_all_graphs():
    truth = np.array([[1, 0, 1], [1, 0, 0], [0, 0, 1]], bool)
    assert best_constant(truth) == pytest.approx(7 / 9)


def test_at_equal_geometry_a_row_that_sees_geometry_only_is_at_chance():
    rng = np.random.default_rng(0)
    truth = rng.random((200, 3)) < 0.5
    gap = np.where(truth, 1.0, 1.5) * np.exp(0.3 * rng.standard_normal(truth.shape))
    same = np.zeros_like(gap)
    assert matched_auc(1 / gap, truth, gap, same) == pytest.approx(0.5, abs=0.1)
    assert matched_auc(truth.astype(float), truth, gap, same) == 1.0
    assert matched_auc(1 - truth.astype(float), truth, gap, same) == 0.0
    assert np.isnan(matched_auc(gap, truth, np.where(truth, 1.0, 9.0), same))


def test_constant_rows_score_as_they_must(file: Path, tmp_path: Path):
    plan = SumoPlan(tmp_path / "out", (file,), seeds=1, rows=("nobody follows", "everybody follows the next"))
    table = run_sumo(plan).set_index(["row", "set", "score"])["value"]
    nobody, chain = "nobody follows", "everybody follows the next"
    assert table[nobody, "EIDM", "balanced_accuracy"] == 0.5
    assert table[nobody, "all", "false_follow"] == 0.0
    truth = plan.test.truth
    called = np.array([[i == j + 1 for i, j in np.array(pairs(3))[AHEAD]]] * COUNT)
    wanted = (called[truth].mean() + (~called[~truth]).mean()) / 2
    assert table[chain, "all", "balanced_accuracy"] == pytest.approx(wanted)
    steps = plan.test.steps
    every = np.broadcast_to(called[..., None], steps.shape)
    by_step = (every[steps].mean() + (~every[~steps]).mean()) / 2
    assert table[chain, "all", "step_balanced_accuracy"] == pytest.approx(by_step)
    assert by_step != pytest.approx(wanted)
    beside = ~truth & ~plan.test.same_lane
    assert table[chain, "all", "false_follow_lane_beside"] == pytest.approx(called[beside].mean())
    first = (tmp_path / "out/sumo.csv").read_bytes()
    run_sumo(plan)
    assert (tmp_path / "out/sumo.csv").read_bytes() == first
    assert card(plan)["sets"][-1]["scenes"] == COUNT - 2


@pytest.mark.parametrize("wrong", [{"gold": False}, {"kinds": ["merge"]}])
def test_files_without_gold_labels_of_triples_are_refused(tmp_path: Path, wrong: dict[str, object]):
    path = tmp_path / "scenes.parquet"
    with writing(path, Header(dt=0.2, provenance={"sumo": ORIGIN | wrong})) as write:
        write(block("test"))
    with pytest.raises(InputError, match="--kind triple --gold"):
        read_sumo_file(path)
