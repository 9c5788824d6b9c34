from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd
import pytest
import torch

from gri.core.policy import IntelligentDriver
from gri.data.ngsim.extract import extract
from gri.data.ngsim.rules import Rules
from gri.errors import InputError
from gri.paper import table2
from gri.paper.table2 import IDM, ROWS, Job, jobs_of
from gri.paper.table2_report import Order, publish
from gri.training.grounded.recorded_traffic import RecordedSettings
from gri.training.train import TrainConfig
from tests.gri.data.ngsim.conftest import as_text, platoon

CF = "ngsim_car_following"


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    """Three platoons, whose numbers put them to testing, training and validation."""
    platoons = [platoon(first_id=n, lane=lane) for lane, n in ((1, 1), (2, 301), (3, 901))]
    path = as_text(pd.concat(platoons), tmp_path / "us-101.txt")
    extract([path], tmp_path / "scenes.parquet", Rules(drawn=0), kinds=("car_following",))
    return tmp_path / "scenes.parquet"


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch):
    """Every training is one update, and the IDM keeps its defaults."""
    read = table2.read_train_config

    def tiny(path: Path) -> TrainConfig:
        config = read(path)
        decoder = msgspec.structs.replace(config.decoder, hidden=8)
        objective = config.objective
        if not isinstance(objective, RecordedSettings):
            objective = msgspec.structs.replace(objective, updates=1)
        return msgspec.structs.replace(config, decoder=decoder, objective=objective)

    monkeypatch.setattr(table2, "read_train_config", tiny)
    monkeypatch.setattr(table2.idm, "calibrate", lambda scenes, dt, progress: IntelligentDriver(dt))


def test_rows_come_seed_by_seed_and_transfers_last():
    made = [(job.row.name, job.seed, job.site) for job in jobs_of(CF, 2, ["a", "b"], ["GRI", "NRI"])]
    assert made == [
        (IDM.name, 0, None), ("GRI", 0, None), ("NRI", 0, None), ("GRI", 1, None), ("NRI", 1, None),
        (IDM.name, 0, "a"), (IDM.name, 0, "b"), ("GRI", 0, "a"), ("GRI", 0, "b"),
    ]  # fmt: skip


def test_lane_changes_have_neither_idm_nor_transfers():
    made = jobs_of("ngsim_lane_changing", 1, ["a", "b"])
    assert [job.row for job in made] == list(ROWS)
    assert {job.site for job in made} == {None}


def test_an_unknown_row_lists_the_known_ones():
    with pytest.raises(InputError, match="got row GPT, wanted one of GRI, GRI"):
        jobs_of(CF, 1, [], ["GPT"])


def test_whatever_a_result_depends_on_names_its_folder(tmp_path: Path):
    jobs = [Job(CF, row, seed, site) for row in (*ROWS, IDM) for seed in (0, 1) for site in (None, "us-101")]
    folders = {job.folder(tmp_path, file) for job in jobs for file in ("one", "two")}
    assert len(folders) == 2 * len(jobs)


def test_what_is_done_is_kept(scene_file: Path, tmp_path: Path, short: None, monkeypatch: pytest.MonkeyPatch):
    job = Job(CF, ROWS[-1], 0)
    assert job.row.name == "Supervised"
    made = table2.run(job, scene_file, tmp_path)
    assert made["graphs"] is None
    assert {"rmse_x", "rmse_v", "ade", "min_fde"} <= set(made["errors"])
    assert len(made["errors"]["rmse_x"]) == len(made["site"]) == 1
    assert made["ood_types"] == [0, 1]

    def never(*arguments: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(table2, "train", never)
    assert table2.run(job, scene_file, tmp_path) == made


def test_the_page_has_every_row_beside_the_papers_figures(scene_file: Path, tmp_path: Path, short: None):
    out = tmp_path / "out"
    order = Order(CF, scene_file, 1, out, tmp_path / "jobs", ("NRI", "Supervised"))
    written = publish(order)
    assert {path.name for path in written} == {
        "table2.md", "table2.csv", "table2_ood.csv", "table2.json",
        "f6_edge_frequencies_ngsim.png", "f10_success_ngsim.png",
    }  # fmt: skip
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
    again = publish(replace(order, rows=(), seeds=5, finished=True))  # leaves out what was never trained
    assert again == written
    assert (out / "table2.md").read_text() == text


def test_nothing_finished_is_one_error(scene_file: Path, tmp_path: Path):
    with pytest.raises(InputError, match="nothing is finished"):
        publish(Order(CF, scene_file, 1, tmp_path / "out", tmp_path / "jobs", finished=True))


def straight_on(start: torch.Tensor, steps: int) -> torch.Tensor:
    """[S, N, T, 3] at the speeds of the start."""
    time = 0.2 * torch.arange(steps)
    x = start[..., :1] + start[..., 1:2] * time
    return torch.stack([x, start[..., 1:2].expand_as(x), torch.zeros_like(x)], -1)


def test_constant_speed_is_driven_without_error_by_whoever_keeps_it(
    scene_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(table2.idm, "calibrate", lambda scenes, dt, progress: IntelligentDriver(dt))
    monkeypatch.setattr(table2.idm, "drive", lambda driver, start, ahead: straight_on(start, ahead.shape[1]))
    made = table2.run(Job(CF, IDM, 0), scene_file, tmp_path)
    assert made["errors"]["rmse_x"][0] == pytest.approx(0.0, abs=0.02)
    assert made["compared"]["wasserstein_speed"] == pytest.approx(0.0, abs=0.02)
