"""What is said of a policy before torch is imported is what is said when it is loaded."""

import pytest
from msgspec.structs import replace

from cosim.runs.policy_fit import check_named_policy
from cosim.runs.policy_loading import policy_of
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import Idm, Rss, TrainedPolicy
from gri.errors import InputError
from gri.resources import checkpoints, find_checkpoint

FOLLOWING, MERGE = load_scenario("us101_car_following"), load_scenario("us101_merge")


@pytest.mark.parametrize("name", checkpoints())
@pytest.mark.parametrize("scenario", [FOLLOWING, MERGE, replace(FOLLOWING, group=replace(FOLLOWING.group, size=5))])
def test_both_say_the_same_of_every_released_checkpoint(name, scenario):
    chosen = replace(scenario, policy=TrainedPolicy(checkpoint=name))
    assert said_by(check_named_policy, chosen) == said_by(policy_of, chosen)


@pytest.mark.parametrize(
    "fields",
    [
        {"step": 0.5},
        {"policy_period": 0.4},
        {"policy_period": 0.4, "policy": Idm()},
        {"policy_period": 0.6, "policy": Rss()},
        {"reinfer_s": 0.3, "step": 0.1},
        {"reinfer_s": 0.3, "step": 0.1, "policy_period": 0.2, "policy": Idm()},
        {"history": 1.0},
    ],
)
def test_both_say_the_same_of_periods_and_histories(fields):
    chosen = replace(MERGE, **fields)
    assert said_by(check_named_policy, chosen) == said_by(policy_of, chosen)


@pytest.mark.parametrize("place", [20, -20])
def test_both_say_the_same_of_a_damaged_file(place, tmp_path):
    """In the header, and in the tensors."""
    content = bytearray(find_checkpoint("us101_merge").read_bytes())
    content[place] ^= 1
    (tmp_path / "damaged.safetensors").write_bytes(content)
    chosen = replace(MERGE, policy=TrainedPolicy(checkpoint=str(tmp_path / "damaged.safetensors")))
    said = said_by(check_named_policy, chosen)
    assert said
    assert said == said_by(policy_of, chosen)


def said_by(check, scenario) -> str:
    try:
        check(scenario)
    except InputError as error:
        return str(error)
    return ""
