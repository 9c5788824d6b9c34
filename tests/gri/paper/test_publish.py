"""Small reproductions from end to end."""

import json
from dataclasses import replace
from pathlib import Path

import msgspec
import pandas as pd
import pytest

from gri.paper import rows, wrong_constants
from gri.paper.plan import Plan
from gri.paper.publish import publish
from gri.paper.rows import IDM, ROWS
from gri.paper.wrong_constants import Case
from gri.training.grounded.constants_search import ConstantsSearch


def test_car_following_has_every_row_beside_the_papers_figures(following_file: Path, tmp_path: Path, short: None):
    out = tmp_path / "car_following"
    plan = Plan("table2", 1, out=tmp_path, cache=tmp_path / "jobs", ngsim=following_file, rows=("NRI", "Supervised"))
    plan = replace(plan, scenario="ngsim_car_following")
    written = publish(plan)
    figures = {
        f"{name}.{kind}" for name in ("f6_edge_frequencies_ngsim", "f10_success_ngsim") for kind in ("png", "svg")
    }
    tables = {f"{name}.{kind}" for name in ("table2", "table2_ood") for kind in ("csv", "parquet")}
    assert {path.name for path in written} == {"table2.md", "table2.json"} | figures | tables
    text = (out / "table2.md").read_text()
    assert "{" not in text
    assert "1 of us-101, cut from us-101.txt" in text
    assert "1.482 ± 0.938" in text  # the paper's Supervised
    assert "| IDM, calibrated |" in text
    assert "| recorded |" in text
    scores = pd.read_csv(out / "table2.csv")
    assert set(scores["row"]) == {IDM.name, "NRI", "Supervised"}
    assert float(scores.query("row == 'NRI' and metric == 'accuracy'")["mean"].iloc[0]) <= 1
    assert not set(scores.columns) & {"x", "vehicle", "scene"}  # aggregates only
    made = json.loads((out / "table2.json").read_text())
    assert made["rows"] == {IDM.name: [0], "NRI": [0], "Supervised": [0]}
    again = publish(replace(plan, rows=(), seeds=5, finished=True))  # leaves out rows that were never trained
    assert again == written
    assert (out / "table2.md").read_text() == text


@pytest.mark.slow
def test_lane_changes_of_rows_that_infer_graphs_are_fine_tuned_and_written(
    lane_file: Path, tmp_path: Path, short: None
):
    chosen = ("GRI", "GRI (paper)", "NRI")
    plan = Plan("table2", 1, out=tmp_path, cache=tmp_path / "jobs", ngsim=lane_file, rows=chosen)
    written = publish(replace(plan, scenario="ngsim_lane_changing"))
    text = (tmp_path / "lane_changing/table2.md").read_text()
    assert "4 recorded windows in 2 groups that share no vehicle" in text
    assert [text.count(f"| {name} |") for name in ("GRI", "GRI, fine-tuned")] == [2, 2]
    curves = pd.read_csv(tmp_path / "lane_changing/table2_ood.csv")
    counts = curves.groupby("stage").size()
    assert set(counts.index) == {"drawn only", "fine-tuned"}
    assert counts.nunique() == 1
    assert "98.5 ± 0.1" in text  # the paper's accuracy
    assert all(path.is_file() for path in written)


@pytest.mark.slow
def test_every_synthetic_target_is_written_by_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(rows, "rows_of", lambda scenario, table: tuple(r for r in ROWS if r.name in ("GRI", "NRI")))
    plan = Plan("table1", 1, 20, tmp_path, tmp_path / "jobs", tmp_path / "scenes", "car_following", quick=True)
    for target in ("table1", "table3", "ood", "figures"):
        written = publish(replace(plan, target=target))
        assert all(path.stat().st_size > 0 for path in written)
        made = json.loads((tmp_path / f"{target}.json").read_text())
        assert made["seeds"] == [0]
        assert made["jobs"] == 2
    assert (tmp_path / "figures" / "f8_success_car_following.png").is_file()


def test_wrong_constants_are_written_with_their_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    search = ConstantsSearch(draws=1, screening_scenes=2, scenes=4, rounds=((1, 1),), batch=2)
    monkeypatch.setattr(wrong_constants, "CASES", (Case("all x2", {"time_headway": 2.0}, search),))
    idm = msgspec.structs.replace(wrong_constants.EXPERTS["idm"], train=6)
    monkeypatch.setattr(wrong_constants, "EXPERTS", {"idm": idm})
    plan = Plan("constants", 1, 8, tmp_path, tmp_path / "jobs", tmp_path / "scenes")
    written = publish(plan)
    assert {path.name for path in written} == {f"constants.{kind}" for kind in ("md", "csv", "parquet", "json")}
    assert json.loads((tmp_path / "constants.json").read_text())["command"].startswith("gri reproduce constants")
    assert len(pd.read_parquet(tmp_path / "constants.parquet")) == 1
    assert publish(replace(plan, finished=True)) == written
