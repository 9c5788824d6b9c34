from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest
import torch

from gri.core.scenes import Scenes
from gri.core.trajectory import Trajectory
from gri.data.ngsim.extract import extract
from gri.data.ngsim.rules import Rules
from gri.data.ranges.recorded import NGSIM_LANE_CHANGING
from gri.data.scene_file.reading import Recorded
from gri.evaluation.recorded_scores import RATIOS
from gri.paper import table2, table2_lanes
from gri.paper.table2 import ROWS, Job
from gri.paper.table2_report import Order, publish
from gri.training.fine_tuning import FineTuning
from gri.training.grounded.recorded_traffic import RecordedSettings
from gri.training.grounded.settings import GroundedSettings
from gri.training.train import TrainConfig
from tests.gri.data.ngsim.conftest import as_text, merging, platoon

LC = "ngsim_lane_changing"


def windows(*vehicles: tuple[int, int, int], site: str = "us-101") -> Recorded:
    """A `Recorded` of which only the numbers matter."""
    count = len(vehicles)
    state = torch.zeros(count, 3, 2, 6)
    words = np.full(count, site, object)
    return Recorded(
        Trajectory.complete(state, 0.2), torch.zeros(count, 6, dtype=torch.int64), words, words,
        np.array(vehicles), torch.zeros(count, 3),
    )  # fmt: skip


def test_windows_that_share_a_vehicle_are_in_one_fold():
    found = windows((1, 2, 3), (4, 5, 6), (3, 7, 8), (8, 9, 10), (11, 12, 13))
    cluster, fold = table2_lanes.fold_of(found, folds=2)
    assert cluster[0] == cluster[2] == cluster[3]
    assert len(set(cluster.tolist())) == 3
    assert fold.tolist() == [0, 1, 0, 0, 1]  # the cluster of three, then the two others where there are fewer


@pytest.fixture
def lane_file(tmp_path: Path) -> Path:
    """Lane changes in two recordings, and platoons to draw others from."""
    tables = [merging(), platoon(3, 120, first_id=301, lane=4), platoon(3, 120, first_id=901, lane=5)]
    again = merging(first_id=101).assign(
        Global_Time=lambda t: t["Global_Time"] + 10**7, Local_Y=lambda t: 1.1 * t["Local_Y"], v_Vel=33.0
    )
    path = as_text(pd.concat([*tables, again]), tmp_path / "us-101.txt")
    extract([path], tmp_path / "lanes.parquet", Rules(changing_stride=None), ("lane_changing_h1", "lane_changing_h2"))
    return tmp_path / "lanes.parquet"


def test_nobody_of_a_recorded_lane_change_is_in_a_drawn_one(lane_file: Path):
    real, found, drawn, validation = table2_lanes.recorded_and_drawn(lane_file, NGSIM_LANE_CHANGING)
    assert len(real) == len(found) == 4  # two lane changes under two readings
    assert {int(v) for v in found.vehicle.ravel()} <= {1, 2, 3, 4, 101, 102, 103, 104}
    assert len(drawn) > 0
    assert len(validation) > 0
    assert table2_lanes.readings(real, NGSIM_LANE_CHANGING).tolist() == [0, 0, 1, 1]


def test_only_first_lateral_speeds_and_accelerations_are_blurred(lane_file: Path):
    drawn = table2_lanes.recorded_and_drawn(lane_file, NGSIM_LANE_CHANGING)[2]
    blurred = table2_lanes.blurred(drawn, NGSIM_LANE_CHANGING, seed=0)
    changed = (blurred.state != drawn.state).nonzero()
    assert set(changed[:, 1].tolist()) == {0, 1}  # the leader is given
    assert set(changed[:, 2].tolist()) == {0}
    assert set(changed[:, 3].tolist()) == {3, 5}
    assert torch.equal(blurred.action, drawn.action)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch):
    """Every training is one update."""
    read = table2.read_train_config

    def tiny(path: Path) -> TrainConfig:
        config = read(path)
        objective = config.objective
        if isinstance(objective, RecordedSettings):
            grounded = GroundedSettings(updates=1, likelihood="stepwise", batch=2, return_batch=2, encoder_lead=1)
            objective = RecordedSettings(grounded=grounded, reward_updates=1, reward_batch=2)
        else:
            objective = msgspec.structs.replace(objective, updates=1)
        return msgspec.structs.replace(
            config,
            objective=objective,
            decoder=msgspec.structs.replace(config.decoder, hidden=8),
            encoder=msgspec.structs.replace(config.encoder, hidden=8),
        )

    monkeypatch.setattr(table2, "read_train_config", tiny)
    monkeypatch.setattr(table2_lanes, "TUNING", FineTuning(updates=1))


def test_every_window_is_tested_once_by_a_model_that_never_saw_its_vehicles(
    lane_file: Path, tmp_path: Path, short: None, monkeypatch: pytest.MonkeyPatch
):
    learned, tested = [], []
    tune, examine = table2_lanes.fine_tune, table2_lanes.examined

    def fine_tune(model, reward, config, scenes: Scenes, tuning, seed):
        learned.append(scenes)
        tune(model, reward, config, scenes, tuning, seed)

    def examined(model, scenes: Scenes, meaning):
        tested.append(scenes)
        return examine(model, scenes, meaning)

    monkeypatch.setattr(table2_lanes, "fine_tune", fine_tune)
    monkeypatch.setattr(table2_lanes, "examined", examined)
    job = Job(LC, ROWS[-1], 0)
    result = table2.run(job, lane_file, tmp_path)
    real, _, drawn, _ = table2_lanes.recorded_and_drawn(lane_file, NGSIM_LANE_CHANGING)
    whole, folds = tested[0], tested[1:]
    torch.testing.assert_close(whole.state, real.state)
    assert sum(len(fold) for fold in folds) == len(real) == len(result["errors"]["rmse_y"])
    for mine, others in zip(folds, learned, strict=True):
        assert len(others) == min(
            (1 + table2_lanes.BESIDE) * (len(real) - len(mine)), len(real) - len(mine) + len(drawn)
        )
        assert not any(torch.equal(a, b) for a in mine.state for b in others.state)
    assert sum(point["scenes"] for point in result["ood"][:1]) == len(real)
    assert len(result["before"]["errors"]["rmse_x"]) == len(real)
    written = publish(Order(LC, lane_file, 1, tmp_path / "out", tmp_path, finished=True))
    assert not [path for path in written if "frequencies" in path.name]  # nobody inferred graphs


@pytest.mark.slow
def test_grounded_models_the_game_and_nri_are_fine_tuned_and_written_up(lane_file: Path, tmp_path: Path, short: None):
    written = publish(Order(LC, lane_file, 1, tmp_path / "out", tmp_path / "jobs", ("GRI", "GRI (paper)", "NRI")))
    text = (tmp_path / "out/table2.md").read_text()
    assert "4 recorded windows in 2 groups that share no vehicle" in text
    assert [text.count(f"| {name} |") for name in ("GRI", "GRI, fine-tuned")] == [2, 2]
    curves = pd.read_csv(tmp_path / "out/table2_ood.csv")
    assert curves.groupby("stage").size().to_dict() == dict.fromkeys(("drawn only", "fine-tuned"), 3 * len(RATIOS))
    assert "98.5 ± 0.1" in text  # the paper's accuracy
    assert all(path.is_file() for path in written)
    assert {path.suffix for path in written} == {".md", ".csv", ".png", ".json"}
