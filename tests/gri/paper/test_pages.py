"""Tables of pages from small data frames."""

import pandas as pd
import pytest

from gri.evaluation.out_of_distribution import Front
from gri.paper.pages import flip_table, rate_table, score_table, weight_table
from gri.paper.rows import SCENARIOS
from gri.paper.score_frames import areas

FOLLOWING, LANES = SCENARIOS[0], SCENARIOS[2]


def test_scores_stand_beside_the_papers():
    line = {"scenario": "car_following", "half_width": 0.0, "scenes": 10}
    seeds = [{"seed": 0, "mean": 0.02, "std": 0.01}, {"seed": 1, "mean": 0.04, "std": 0.03}]
    metrics = ("rmse_x", "rmse_v", "training_cpu_seconds")
    scores = pd.DataFrame([line | {"row": "Supervised", "metric": m} | seed for seed in seeds for m in metrics])
    table = score_table(FOLLOWING, scores).splitlines()
    assert len(table) == 3
    cells = [cell.strip() for cell in table[2].strip("|").split("|")]
    assert cells[:3] == ["Supervised", "0.0300 ± 0.0200 [0.0200, 0.0400]", "0.039 ± 0.016"]
    assert cells[5:9] == ["–", "–", "–", "–"]
    assert cells[9] == "2"


def test_the_empty_graph_is_a_reference_without_seeds():
    line = {"row": "GRI", "seed": 0, "std": 0.1, "metric": "accuracy", "mean": 1.0}
    scores = pd.DataFrame([line, line | {"metric": "empty_graph_accuracy", "mean": 2 / 3}])
    table = score_table(FOLLOWING, scores).splitlines()
    assert table[2].startswith("| GRI | – | 0.241 ± 0.125 |")
    assert table[3] == "| empty graph | – | – | – | – | 66.67 | – | – | – | – | – |"


def test_flips_are_shown_for_the_lowest_seed():
    shares = [("flip a", 0, 1.0), ("flip a", 1, 0.97), ("flip b", 0, 0.5)]
    flips = pd.DataFrame(
        [{"row": "GRI", "metric": metric, "seed": seed, "mean": mean} for metric, seed, mean in shares]
    )
    table = flip_table(LANES, flips).splitlines()
    assert table[0] == "| model | a | b |"
    assert table[2] == "| GRI | 97.0 | 50.0 |"


def test_learned_weights_stand_below_the_true_ones():
    weights = pd.DataFrame({"row": "GRI", "seed": [0, 1], "metric": "node.v", "mean": [1.0, 2.0], "true": 3.0})
    assert weight_table(FOLLOWING, weights).splitlines()[2:] == ["| true | 3.00 |", "| GRI | 1.50 [1.00, 2.00] |"]


def test_collisions_stand_in_a_table_without_areas():
    base = {"scenario": "lane_changing", "front": "policy", "success": 1.0}
    curves = pd.DataFrame(
        [base | {"row": "oracle", "seed": -1, "headway": x, "collision": 0.0} for x in (0.0, 4.0)]
        + [base | {"row": "GRI", "seed": 0, "headway": x, "collision": c} for x, c in ((0.0, 0.25), (4.0, 0.0))]
    )
    assert rate_table(LANES, curves, Front.POLICY, "collision").splitlines()[-1] == "| GRI | 0.0 | 25.0 |"
    success = rate_table(LANES, curves, Front.POLICY).splitlines()
    assert success[-1] == "| GRI | 100.0 | 100.0 | 1.000 | 1.000 | 1 |"


def test_areas_are_compared_with_the_oracle():
    base = {"scenario": "car_following", "front": "policy"}
    curves = pd.DataFrame(
        [base | {"row": "oracle", "seed": -1, "headway": x, "success": 0.5} for x in (0.0, 4.0)]
        + [base | {"row": "GRI", "seed": 0, "headway": x, "success": s} for x, s in ((0.0, 0.0), (4.0, 0.5))]
    )
    found = areas(curves).set_index("row")
    assert found.loc["GRI", "area"] == pytest.approx(0.25)
    assert found.loc["GRI", "share_of_oracle"] == pytest.approx(0.5)
