"""Runs in which policies drive shares of the traffic, from the file to the tables."""

from pathlib import Path

import pytest
import yaml

import cosim
from cosim.runs.share_policies import share_plans
from cosim.runs.share_reading import SHARE_TABLES
from cosim.spec.loading import load_scenario, override
from gri.table import terminal_text
from tests.cosim.runs.test_own_files import folder as folder

pytestmark = pytest.mark.usefixtures("forked_workers")
SHARES = {"acc": {"share": 0.2, "policy": {"kind": "sumo_model", "model": "ACC"}}}


def test_a_share_of_a_net_and_traffic_of_the_user_is_driven(folder: Path) -> None:
    content = yaml.safe_load((folder / "mine.yaml").read_text())
    del content["group"]
    content |= {"policy": {"kind": "idm"}, "share": 0.3, "shares": SHARES, "time_limit": 20}
    (folder / "share.yaml").write_text(yaml.safe_dump(content))
    done = cosim.run_traffic(folder / "share.yaml", folder=folder / "run")
    assert [*done.traffic["driver"]] == ["all", "idm", "acc", "sumo"]
    everybody, idm, acc, _ = done.traffic.to_dict("records")
    assert everybody["flow"] == pytest.approx(done.traffic["flow"][1:].sum())
    assert everybody["contacts"] == everybody["misplaced"] == 0
    assert idm["by_policy"] > 0.5
    assert idm["speed_error"] == 0.0
    assert acc["vehicles"] > 0
    assert everybody["fuel"] > 10  # [g/km]: emissions are read
    assert not (folder / "counts.xml").exists()
    assert done.samples is not None
    assert done.samples.groupby("time")["vehicle"].nunique().max() > 10
    assert (done.folder / "space-time.png").stat().st_size > 10_000
    assert {path.stem for path in done.folder.glob("*.parquet")} == {*SHARE_TABLES, "samples"}
    assert max(map(len, terminal_text(done.summary(), 80).splitlines())) <= 80
    assert cosim.open_traffic_run(done.folder).traffic.equals(done.traffic)


def test_a_checkpoint_for_merges_and_a_scenario_without_the_right_door_are_refused_in_one_line() -> None:
    scenario = load_scenario("us101_share")
    merging = override(scenario, {"policy": {"kind": "gri", "checkpoint": "us101_merge"}})
    with pytest.raises(cosim.InputError, match="lanes left to SUMO; choose a car-following checkpoint"):
        share_plans(merging)
    with pytest.raises(cosim.InputError, match="run_traffic"):
        cosim.run(scenario)
    with pytest.raises(cosim.InputError, match="add share"):
        cosim.run_traffic("us101_car_following")
