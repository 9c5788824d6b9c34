"""What the options of `cosim realism --test` select; the simulation is replaced by a given one."""

import json

import numpy as np
import pandas as pd
import pytest

from cosim.commands import realism
from cosim.runs.traffic_survey import Survey


def samples(mean: float, seed: int) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    time = np.arange(20.0)
    tracks = [
        pd.DataFrame({"time": time, "vehicle": f"{k}", "lane": 1.0 + k % 3, "x": 12 * k + v * time, "v": v, "a": 0.0})
        for k, v in enumerate(rng.normal(mean, 2, 30).clip(0))
    ]
    return pd.concat(tracks, ignore_index=True).assign(length=4.0, source="r")


def with_fast_lane(table: pd.DataFrame) -> pd.DataFrame:
    """The table and a lane 4, in which everybody is three times as fast."""
    added = table.assign(lane=4.0, v=3 * table["v"], vehicle=table["vehicle"] + "x")
    return pd.concat([table, added], ignore_index=True)


@pytest.fixture
def ceilings(tmp_path, monkeypatch):
    """A function from (test part, fit part, --lanes) to the ceilings that the command writes."""
    survey = Survey(samples(12, 3), 0.0, 0, 0, 0)
    monkeypatch.setattr(realism, "survey_of", lambda *_: survey)
    runs = iter(range(9))

    def found(test: pd.DataFrame, fit: pd.DataFrame, lanes: list[int]) -> dict[str, float]:
        folder = tmp_path / f"{next(runs)}"
        for name, table in (("test", test), ("fit", fit)):
            table.to_parquet(tmp_path / f"{name}.parquet")
        sought = realism._Score(tmp_path / "test.parquet", tmp_path / "fit.parquet", 0.0, 1, 4, None, 20.0, [], lanes)
        realism._score("us101_car_following", sought, folder, "table")
        rows = json.loads((folder / "score.json").read_text())["quantities"]
        return {row["quantity"]: row["recorded"] for row in rows if row["kind"] == "likelihood"}

    return found


def test_lanes_are_chosen_in_both_parts_of_the_recording(ceilings):
    test, fit = samples(12, 1), samples(12, 2)
    chosen = ceilings(with_fast_lane(test), with_fast_lane(fit), [1, 2, 3])
    assert chosen == ceilings(test, fit, [])
    assert ceilings(test, with_fast_lane(fit), [])["v"] < 0.9 * chosen["v"]
