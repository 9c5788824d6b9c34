"""Scenes of one short, real simulation in this process."""

from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest

from cosim.measures.relation_labels import Reduction
from cosim.scenes.scene_rules import TRIPLE_SHARES, Rules, hypothesis
from cosim.scenes.seed_scenes import SeedSpec, SeedStatistics, extract_scenes
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import CarFollowing, Merge, Scenario
from cosim.world.groups import expected_graph
from gri.data.scene_file.schema import Header, writing


def short(**changes: float) -> Scenario:
    scenario = load_scenario("us101_merge")
    traffic = msgspec.structs.replace(scenario.traffic, warm_up=60.0)
    return msgspec.structs.replace(scenario, traffic=traffic, **{"time_limit": 60.0, **changes})


def extracted(folder: Path, scenario: Scenario, **options: object) -> tuple[pd.DataFrame, SeedStatistics]:
    spec = SeedSpec(**{"scenario": scenario, "source": "test", "split": "train", "kinds": ("car_following", "merge"),
                   "count": 4, "gold": False, "rules": Rules()} | options)  # fmt: skip
    path = folder / "scenes.parquet"
    with writing(path, Header(dt=0.2, vehicles=scenario.group.size)) as write:
        figures = extract_scenes(spec, find_net("us101"), folder, write)
    return pd.read_parquet(path), figures


@pytest.fixture(scope="module")
def scenes(tmp_path_factory) -> pd.DataFrame:
    return extracted(tmp_path_factory.mktemp("scenes"), short())[0]


def test_the_hypothesis_is_the_papers():
    assert expected_graph(CarFollowing()) == hypothesis("car_following", 3)
    assert expected_graph(Merge(lane="weave_0", zone=(0, 1))) == hypothesis("merge", 3)


def test_chains_stay_in_order_and_close(scenes):
    chains = scenes[scenes["kind"] == "car_following"]
    assert chains.groupby("scene", observed=True).size().tolist() == [90] * chains["scene"].nunique()
    x = chains.pivot_table(index=["scene", "step"], columns="role", values="x")
    headways = np.diff(x.to_numpy())
    assert ((headways > 0) & (headways < 50)).all()


def test_a_merge_comes_from_the_lane_beside_and_ends_between_its_partners(scenes):
    merges = scenes[scenes["kind"] == "merge"]
    assert merges["scene"].nunique() > 0
    last = merges[merges["step"] == 39].pivot_table(index="scene", columns="role", values=["x", "y"])
    assert (last["x", 1] < last["x", 0]).all()
    assert (last["x", 0] < last["x", 2]).all()
    assert np.abs(last["y", 0] - last["y", 2]).max() < 0.2
    first = merges[merges["step"] == 0].pivot_table(index="scene", columns="role", values="y")
    assert (np.abs(first[0] - first[2]) > 3).all()


@pytest.mark.parametrize("size", [2, 5])
def test_chains_of_other_sizes(tmp_path: Path, size):
    """Vehicles follow the next one, and nobody else: so say the labels, and so does the geometry."""
    scenario = short(group=CarFollowing(size=size))
    found, figures = extracted(tmp_path, scenario, kinds=("car_following",), count=2)
    assert found.groupby("scene").size().tolist() == [30 * size] * 2
    x = found.pivot_table(index=["scene", "step"], columns="role", values="x")
    assert x.shape[1] == size
    assert (np.diff(x.to_numpy()) > 0).all()
    follows = 0
    for i in range(size):
        edges, hypothesis = (found[name].astype(object) for name in (f"edge_from_{i}", f"hypothesis_from_{i}"))
        assert set(found.loc[hypothesis == "follow", "role"]) == ({i - 1} if i else set())
        assert (hypothesis[edges == "follow"] == "follow").all()
        follows += int((edges == "follow").sum()) // 30
    assert follows >= 1.5 * (size - 1), "of two scenes; a vehicle far behind may not react"
    assert sum(figures.tallies["car_following"]["edges"]) == 2 * size * (size - 1)


def test_no_vehicle_is_in_more_than_two_scenes_of_a_kind(scenes):
    begins = scenes[scenes["step"] == 0]
    assert begins.groupby(["kind", "vehicle"], observed=True).size().max() <= 2


def test_every_scene_has_interaction_and_its_graph_says_what_its_steps_say(scenes):
    names = [f"step_edge_from_{i}" for i in range(3)]
    for _, scene in scenes.groupby("scene"):
        there = scene[names].astype(object)
        assert (there.isin(["follow", "yield", "cut_in"])).to_numpy().sum() >= 5
        for i in range(3):
            for _, vehicle in scene.groupby("role"):
                present = set(vehicle[f"step_edge_from_{i}"].dropna()) - {"none"}
                assert vehicle[f"edge_from_{i}"].iloc[0] in (present or {"none"}) | {None, np.nan}


@pytest.mark.slow
def test_the_same_seed_gives_the_same_scenes_and_another_others(tmp_path: Path, scenes):
    (tmp_path / "again").mkdir()
    again, _ = extracted(tmp_path / "again", short())
    pd.testing.assert_frame_equal(again, scenes)
    (tmp_path / "other").mkdir()
    other, _ = extracted(tmp_path / "other", short(seed=2))
    assert not other["x"].equals(scenes["x"])


def test_quotas_bound_what_is_common(tmp_path: Path):
    rules = Rules(at_most={"follow": 0.5})
    found, figures = extracted(tmp_path, short(), kinds=("car_following",), rules=rules)
    assert found["scene"].nunique() == 2
    assert figures.tallies["car_following"]["rejected"]["enough scenes with follow"] > 0


@pytest.mark.slow
def test_interventions_agree_with_the_rules_of_following(tmp_path: Path):
    found, figures = extracted(tmp_path, short(), kinds=("car_following",), count=3, gold=True)
    counts = np.array(figures.tallies["car_following"]["rule_gold"])
    assert counts.sum() == 3 * 30 * 6
    assert np.trace(counts) / counts.sum() > 0.97
    follows = found[(found["role"] == 0) & (found["step_edge_from_1"] == "follow")]
    assert (follows["effect_from_1"] < -0.1).all()


@pytest.mark.slow
def test_triples_have_the_wanted_graphs(tmp_path: Path):
    rules = Rules(reduction=Reduction.LONGEST)
    found, figures = extracted(tmp_path, short(time_limit=120.0), kinds=("triple",), count=20, gold=True, rules=rules)
    wanted = {name: round(20 * share) for name, share in TRIPLE_SHARES.items()}
    assert figures.tallies["triple"]["graphs"] == wanted
    x = found.pivot_table(index=["scene", "step"], columns="role", values="x").to_numpy()
    assert np.diff(x).min() >= 6.0  # 7 m from front to front, at positions of half a step later
    lane = found[found["step"] == 0].pivot_table(index="scene", columns="role", values="y").to_numpy()
    followers = found[(found["role"] == 0) & (found["step"] == 0)]["edge_from_2"].to_numpy() == "follow"
    assert (np.abs(lane[followers, 1] - lane[followers, 0]) > 2).all()  # the vehicle in between is in another lane


def test_a_finer_step_gives_scenes_of_the_same_rate(tmp_path: Path):
    found, figures = extracted(tmp_path, short(step=0.1), kinds=("car_following",), count=2)
    assert found["scene"].nunique() == 2
    assert sorted(found["time"].drop_duplicates().diff().dropna().round(3).unique())[0] == 0.2
    assert figures.steps == round(figures.simulated / 0.1)


def test_a_long_window_may_outlast_a_leader_that_leaves_the_net(tmp_path):
    """How hard it can brake is asked while it is there: in these 20 s, one behind which a merger drove is gone."""
    rules = Rules(merging_steps=100, strategic=False)
    found, figures = extracted(tmp_path, short(seed=8, time_limit=150.0), kinds=("merge",), count=60, rules=rules)
    assert figures.tallies["merge"]["scenes"] == found["scene"].nunique() >= 1
    assert found.groupby("scene")["step"].nunique().eq(100).all()
