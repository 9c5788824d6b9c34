"""From recordings of other layouts to a scored model, by the commands."""

from pathlib import Path

import pandas as pd
import pytest

from gri.errors import InputError
from tests.gri.commands.test_cli import run
from tests.gri.data.recordings import layout_files


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_from_highd_to_a_scored_model(here: Path):
    layout_files.highd(layout_files.traffic(), here / "data")
    report = run("scenes", "inspect", "data/07_tracks.csv")
    for text in ("layout: highd", "Vehicles by class", "motorcycle", "truck", "gri scenes make data/07_tracks.csv"):
        assert text in report
    made = run("scenes", "make", "data/07_tracks.csv", "--split", "all-test", "--out", "scenes.parquet")
    assert "scenes in scenes.parquet" in made
    scored = run("evaluate", "ngsim_car_following", "--scene-file", "scenes.parquet", "--split", "test")
    assert "RMSE_v" in scored
    for printed in (report, made, scored):
        assert all(len(line) <= 80 for line in printed.splitlines() if "%" not in line)


def test_foreign_columns_are_named_on_the_command_line(here: Path):
    table = pd.read_csv(layout_files.tidy(layout_files.traffic(), here / "data"))
    foreign = table.rename(columns={"time_s": "Zeit", "vehicle_id": "Fz"}).assign(Ort=lambda t: t["s_m"] / 0.3048)
    foreign.drop(columns="s_m").to_csv("mine.csv", sep=";", decimal=",", index=False)
    names = ("--map", "time_s=Zeit", "--map", "vehicle_id=Fz", "--map", "s_m=Ort*0.3048")
    kept = ("--map", "lane=lane", "--map", "d_m=d_m")
    assert "3 recordings" not in run("scenes", "tidy", "mine.csv", *names, *kept, "--out", "tidy.parquet")
    assert "layout: tidy" in run("scenes", "inspect", "tidy.parquet")
    with pytest.raises(InputError, match="--map time_s=Uhr: got no column 'Uhr', wanted one of Zeit"):
        run("scenes", "inspect", "mine.csv", "--map", "time_s=Uhr")
    with pytest.raises(InputError, match="--layout: got nothing, wanted one of ngsim"):
        run("scenes", "inspect", "mine.csv", "--layout", "nothing")


def test_files_of_several_layouts_are_refused(here: Path):
    table = layout_files.traffic(40)
    layout_files.highd(table, here / "a")
    layout_files.tidy(table, here / "b")
    with pytest.raises(InputError, match="got files of several layouts"):
        run("scenes", "make", "a/07_tracks.csv", "b/mine.csv")
