"""Shares of the traffic in a scenario file."""

from pathlib import Path

import pytest
import yaml

from cosim.spec.loading import load_scenario
from cosim.spec.shares import driven_shares
from gri.errors import InputError
from gri.resources import shipped

ACC = {"kind": "sumo_model", "model": "ACC"}


def scenario(folder: Path, **changes: object) -> Path:
    content = yaml.safe_load(shipped("scenarios", "us101_share.yaml").read_text()) | changes
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump({name: value for name, value in content.items() if value is not None}))
    return path


def test_several_policies_have_shares_by_name(tmp_path: Path) -> None:
    found = load_scenario(str(scenario(tmp_path, shares={"cautious": {"share": 0.1, "policy": ACC}})))
    assert {name: share for name, (_, share) in driven_shares(found).items()} == {"gri": 0.2, "cautious": 0.1}
    alone = load_scenario(str(scenario(tmp_path, policy=ACC)))
    assert [*driven_shares(alone)] == ["ACC"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"share": 1.2}, "share"),
        ({"shares": {"acc": {"share": 0.9, "policy": ACC}}}, "add up to 1.1"),
        ({"shares": {"gri": {"share": 0.1, "policy": ACC}}}, "another name"),
        ({"perturbations": [{"kind": "speed_noise", "intensity": 1.0}]}, "perturbations"),
        ({"policy": ACC, "share": None}, "add a share"),
        ({"policy": {**ACC, "parameters": {"cc1": 1.0}}}, "ACC reads only"),
        ({"background": {"kind": "replay", "lane_1": 1.8}}, "replays a recording"),
    ],
)
def test_shares_that_do_not_fit_are_errors_of_one_line(tmp_path: Path, changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        load_scenario(str(scenario(tmp_path, **changes)))
    assert "\n" not in str(error.value)
