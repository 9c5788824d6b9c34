import os
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gri.core.dynamics import POINT_MASS_1D, POINT_MASS_2D
from gri.core.graph import FOLLOWING, EdgeType
from gri.data.ngsim import extract as ngsim_extract
from gri.data.ngsim.defects import clean
from gri.data.ngsim.extract import KINDS, extract, inspect
from gri.data.ngsim.lane_changing import lane_change_groups
from gri.data.ngsim.recordings import recordings
from gri.data.ngsim.rules import Rules, splits_of
from gri.data.ngsim.smoothing import Motion, smoothed
from gri.data.scene_file.reading import read
from gri.data.scene_file.schema import header_of
from gri.errors import InputError
from tests.gri.data.ngsim.conftest import CLOCK, as_portal, as_text, merging, platoon

YIELDING = (EdgeType.NONE, EdgeType.FOLLOW, EdgeType.YIELD)


def motion_of(table: pd.DataFrame, folder: Path) -> Motion:
    (recording,) = recordings(as_text(table, folder / "us-101.txt"))
    return smoothed(clean(recording)[0], Rules().smoothing)


def cut(table: pd.DataFrame, folder: Path, **options):
    return extract([as_text(table, folder / "us-101.txt")], folder / "out.parquet", Rules(**options))


def test_a_platoon_gives_triples_that_do_not_overlap(tmp_path: Path):
    made = cut(platoon(4, frames=125), tmp_path)  # 62 steps: two windows of 30, for 1-2-3 and for 2-3-4
    assert made.scenes == {("us-101", "car_following", "test"): 4}
    scenes = read(tmp_path / "out.parquet", "car_following", POINT_MASS_1D, FOLLOWING)
    np.testing.assert_array_equal(scenes.vehicle, [[1, 2, 3]] * 2 + [[2, 3, 4]] * 2)
    assert scenes.trajectory.state.shape == (4, 3, 30, 3)
    headway = scenes.trajectory.state[:, 1:, :, 0] - scenes.trajectory.state[:, :-1, :, 0]
    np.testing.assert_allclose(headway, 60 * 0.3048, rtol=1e-4)
    assert (scenes.graph == scenes.graph[0]).all()


def test_windows_of_training_vehicles_overlap(tmp_path: Path):
    made = cut(platoon(3, frames=125, first_id=301), tmp_path, drawn=0)
    assert made.scenes == {("us-101", "car_following", "train"): 7}  # starts 0, 5, ... 30 of 62 steps


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"Local_Y": lambda t: t["Local_Y"] * 4 - 3 * 0.1 * 30 * t["Frame_ID"]}, "too far apart"),
        ({"v_Class": lambda t: 1}, "motorcycle"),
        ({"Lane_ID": lambda t: 7}, "ramp or shoulder"),
        ({"Local_X": lambda t: t["Local_X"] + 6 * np.sin(t["Frame_ID"] / 12)}, "swerving"),
        ({"v_Length": lambda t: 61.0}, "vehicles overlap"),
        ({"Vehicle_ID": lambda t: t["Vehicle_ID"] + 197}, "vehicles of different splits"),
        ({"Local_Y": lambda t: t["Local_Y"] - 2.95 * t["Frame_ID"], "v_Vel": lambda t: 0.5}, "standing"),
    ],
)
def test_each_rule_turns_down_and_is_counted(tmp_path: Path, change: dict, reason: str):
    table = pd.concat([platoon(), platoon(clock=1118846980200 + 10**7)])  # two recordings, one of them good
    broken = platoon(clock=1118846980200 + 2 * 10**7).assign(**change)
    made = cut(pd.concat([table, broken]), tmp_path)
    assert made.scenes == {("us-101", "car_following", "test"): 2}
    assert made.rejected["car_following", reason] == 1


def test_a_pair_with_a_vehicle_between_them_is_no_triple(tmp_path: Path):
    with pytest.raises(InputError, match="no scene obeys the rules"):
        cut(merging(frames=70, crossing=20), tmp_path)


@pytest.mark.parametrize(
    ("hypothesis", "vehicles", "edges"),
    [
        ("H1", (1, 2, 3), {(1, 0): EdgeType.YIELD, (2, 1): EdgeType.FOLLOW}),
        ("H2", (1, 4, 2), {(2, 0): EdgeType.YIELD, (0, 1): EdgeType.YIELD, (2, 1): EdgeType.FOLLOW}),
    ],
)
def test_a_lane_change_gives_groups_of_both_hypotheses(tmp_path: Path, hypothesis, vehicles, edges):
    cut(merging(), tmp_path, changing_stride=None)
    scenes = read(tmp_path / "out.parquet", f"lane_changing_{hypothesis.lower()}", POINT_MASS_2D, YIELDING)
    np.testing.assert_array_equal(scenes.vehicle, [vehicles])
    named = {(i, j): YIELDING[int(k)] for (i, j), k in zip(PAIRS, scenes.graph[0], strict=True)}
    assert {pair: kind for pair, kind in named.items() if kind is not EdgeType.NONE} == edges
    y = scenes.trajectory.state[0, 0, :, 1]
    assert float(y[-1] - y[0]) == pytest.approx(12 * 0.3048, abs=0.3)  # to the left
    crossing = int((y > -24 * 0.3048).float().argmax())
    assert abs(crossing - 20) <= 1


PAIRS = [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)]


def test_sampled_lane_changes_are_of_training_vehicles_and_obey_the_dynamics(tmp_path: Path):
    both = pd.concat([platoon(3, frames=100), platoon(3, frames=100, first_id=301, lane=3)])
    made = cut(both, tmp_path, drawn=3)
    assert made.scenes["us-101, lateral motion drawn", "lane_changing_h2", "train"] == 9  # starts 0, 5, 10, three each
    assert not any(split == "test" for site, _, split in made.scenes if "drawn" in site)
    scenes = read(tmp_path / "out.parquet", "lane_changing_h2", POINT_MASS_2D, YIELDING)
    np.testing.assert_array_equal(scenes.vehicle[0], [302, 301, 303])  # from between the other two
    state = scenes.trajectory.state.double()
    action = POINT_MASS_2D.inverse(state[:, :, :-1], state[:, :, 1:], 0.2)
    moved = POINT_MASS_2D.step(state[:, :, :-1], action, 0.2)
    np.testing.assert_allclose(moved[..., 1:], state[:, :, 1:, 1:], atol=1e-4)
    across = (state[:, 0, -1, 1] - state[:, 0, 0, 1]).abs()
    np.testing.assert_allclose(across, 3.66, atol=1.2)


def test_scenes_are_the_same_however_many_are_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    twice = [platoon(3, frames=100, first_id=301), platoon(3, frames=120, first_id=301, clock=CLOCK + 10**7)]
    portal = as_portal({"us-101": pd.concat(twice)}, tmp_path / "portal.csv")
    steps, tables = [], []
    for at_once in (2, 10_000):
        monkeypatch.setattr(ngsim_extract, "SCENES_PER_BLOCK", at_once)
        extract([portal], tmp_path / "out.parquet", Rules(drawn=0), progress=lambda *step: steps.append(step))
        tables.append(pd.read_parquet(tmp_path / "out.parquet"))
    pd.testing.assert_frame_equal(*tables)
    assert tables[0]["scene"].nunique() == 12  # starts 0, 5, 10, 15, 20; the second recording has two more
    assert [step[1:] for step in steps if step[0] == "cutting portal.csv"] == [(1, 2, 5.0), (2, 2, 12.0)] * 2


def test_two_lane_changes_are_no_scene(tmp_path: Path):
    table = merging()
    back = (table["Vehicle_ID"] == 1) & (table["Frame_ID"] > 75)
    table.loc[back, "Local_X"] = 30.0 - 12.0 / (1 + np.exp((table["Frame_ID"][back] - 80) / 3))
    table.loc[back, "Lane_ID"] = np.where(table["Local_X"][back] > 24, 3, 2)
    counts: Counter[str] = Counter()
    assert len(lane_change_groups(motion_of(table, tmp_path), Rules(), "H1", counts)) == 0
    assert counts["several lane changes"] > 0


def test_no_vehicle_is_in_two_splits():
    vehicle = np.arange(1, 5000)
    split = splits_of(vehicle, Rules())
    assert [str(s) for s in split[[0, 99, 199, 899, 998, 999]]] == [
        "test",
        "test",
        "train",
        "validation",
        "validation",
        "test",
    ]
    shares = {name: float((split == name).mean()) for name in ("train", "validation", "test")}
    assert shares == pytest.approx({"train": 0.7, "validation": 0.1, "test": 0.2}, abs=0.01)


def test_the_same_input_gives_the_same_bytes(tmp_path: Path):
    path = as_text(pd.concat([platoon(4), platoon(clock=1118846980200 + 10**7)]), tmp_path / "us-101.txt")
    for name in ("a", "b"):
        extract([path], tmp_path / name, Rules())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    made = header_of(tmp_path / "a").provenance["ngsim"]
    assert made["files"][0]["name"] == "us-101.txt"
    assert made["rules"]["following_steps"] == 30


def shared(name: str) -> Path:
    folder = os.environ.get("GRI_NGSIM_DIR")
    if folder is None:
        pytest.skip("needs recorded data: set GRI_NGSIM_DIR to a folder with us-101.csv.gz and i-80.csv.gz")
    return Path(folder) / name


@pytest.mark.slow
def test_recorded_extracts_give_the_promised_scenes(tmp_path: Path):
    paths = [shared("us-101.csv.gz"), shared("i-80.csv.gz")]
    made = extract(paths, tmp_path / "out.parquet", Rules(training_stride=30))
    by_site = Counter()
    for (site, kind, _), count in made.scenes.items():
        by_site[site, kind[:13]] += count
    assert by_site["i-80", "car_following"] >= 400
    assert by_site["us-101", "car_following"] >= 100
    assert by_site["us-101", "lane_changing"] >= 30
    assert inspect(paths[0])[0][0].defects["accelerations cut off at 11.2 ft/s2"] > 0
    assert {kind for _, kind, _ in made.scenes} == set(KINDS)
