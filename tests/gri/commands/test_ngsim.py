"""The chain from a file in the official layout to a scored model."""

import json
from pathlib import Path

import pandas as pd
import pytest

from gri.commands import ngsim
from gri.data.ngsim.extract import scene_file
from gri.data.ngsim.rules import Rules
from gri.errors import InputError
from tests.gri.commands.test_cli import run
from tests.gri.data.ngsim.conftest import as_text, platoon

TINY = """\
name: tiny_recorded
data: {range: ngsim_car_following, graphs: one}
objective:
  type: gri_recorded
  reward_updates: 1
  reward_batch: 2
  grounded: {updates: 1, likelihood: stepwise, batch: 2, return_batch: 2}
decoder: {kind: recurrent, hidden: 8}
encoder: {hidden: 8}
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with three platoons whose numbers put them to testing, training and validation."""
    monkeypatch.chdir(tmp_path)
    platoons = [platoon(first_id=n, lane=lane) for lane, n in ((1, 1), (2, 301), (3, 901))]
    as_text(pd.concat(platoons), tmp_path / "trajectories-0750am-0805am.txt")
    (tmp_path / "tiny.yaml").write_text(TINY)
    return tmp_path


def test_from_an_official_file_to_a_scored_model(here: Path):
    official = "trajectories-0750am-0805am.txt"
    report = run("ngsim", "inspect", official)
    assert f"Next: gri ngsim scenes {official}" in report
    assert "[m]" in report, "units are no markup"
    assert "[m/s]" in report
    printed = run("ngsim", "inspect", official, "--format", "json")  # progress is in the output of this runner, too
    sizes = json.loads(printed[printed.index("\n{") : printed.rindex("}") + 1])["recordings"][0]
    assert sizes["vehicles"] == len(pd.read_csv(official, sep=r"\s+", header=None)[0].unique())
    assert "Next: gri train ngsim_car_following --ngsim scenes.parquet" in run(
        "ngsim", "scenes", official, "--out", "scenes.parquet"
    )
    assert "Next: gri evaluate runs/tiny_recorded-s0.safetensors" in run(
        "train", "tiny.yaml", "--ngsim", "scenes.parquet"
    )
    scored = run("evaluate", "runs/tiny_recorded-s0.safetensors", "--scene-file", "scenes.parquet", "--split", "test")
    assert "1 test scenes" in scored
    assert "RMSE_v" in scored
    for printed in (report, scored):
        assert all(len(line) <= 80 for line in printed.splitlines())
        assert "…" not in printed


def test_default_options_are_the_rules():
    rules = Rules()
    assert (rules.smoothing.window, rules.smoothing.order) == (ngsim.WINDOW, ngsim.ORDER)
    assert (rules.spacing, rules.training_stride) == (ngsim.SPACING, ngsim.TRAINING_STRIDE)


def test_the_released_model_is_scored_on_any_file_of_the_official_layout(here: Path):
    run("ngsim", "scenes", "trajectories-0750am-0805am.txt", "--out", "held-out.parquet")
    scored = run("evaluate", "ngsim_car_following", "--scene-file", "held-out.parquet")
    assert "5 test scenes" in scored
    assert "accuracy, 6 edges" in scored


def test_training_cuts_scenes_itself_and_keeps_them(here: Path):
    run("train", "tiny.yaml", "--ngsim", str(here))
    (kept,) = (here / "runs/scenes").glob("ngsim-*.parquet")
    assert scene_file(here / "trajectories-0750am-0805am.txt", here / "runs/scenes") == kept


def test_recorded_scenes_are_for_models_of_recorded_traffic(here: Path):
    with pytest.raises(InputError, match="learns from synthetic scenes"):
        run("train", "paper_car_following", "--ngsim", str(here))


def test_a_folder_without_recordings_is_one_error(tmp_path: Path):
    with pytest.raises(InputError, match="got no NGSIM files"):
        scene_file(tmp_path, tmp_path)
