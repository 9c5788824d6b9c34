"""Which policies fit a scenario: their period and its step."""

import msgspec
import pytest

from cosim.runs.policy_loading import policy_of
from cosim.spec.loading import load_scenario, override
from cosim.spec.scenario import Idm
from gri.errors import InputError
from gri.networks.model import RelationalModel
from gri.networks.next_ahead import FollowsNextAhead


def test_a_policy_may_act_less_often_than_sumo_steps() -> None:
    scenario = msgspec.structs.replace(load_scenario("us101_merge"), step=0.1)
    trained = policy_of(scenario)
    assert trained is not None
    assert trained.dt == pytest.approx(0.2)
    idm = policy_of(msgspec.structs.replace(scenario, policy=Idm(), policy_period=0.5))
    assert idm is not None
    assert idm.dt == 0.5


def test_a_period_that_does_not_fit_is_refused() -> None:
    scenario = load_scenario("us101_merge")
    with pytest.raises(InputError, match=r"policy_period is 0.3 s, expected a multiple of step = 0.2 s"):
        override(scenario, {"policy_period": 0.3})
    with pytest.raises(InputError, match=r"step: got 0.5 s, the policy acts every 0.2 s"):
        policy_of(msgspec.structs.replace(scenario, step=0.5))
    with pytest.raises(InputError, match=r"policy_period: got 0.4 s, the policy acts every 0.2 s"):
        policy_of(msgspec.structs.replace(scenario, policy_period=0.4))
    with pytest.raises(InputError, match=r"reinfer_s: got 0.3 s"):
        policy_of(msgspec.structs.replace(scenario, step=0.1, reinfer_s=0.3))


def test_a_trained_policy_that_sees_everybody_follows_who_is_ahead():
    scenario = load_scenario("us101_merge")
    seeing = msgspec.structs.replace(scenario.policy, sees="everybody")
    assert isinstance(policy_of(msgspec.structs.replace(scenario, policy=seeing)), FollowsNextAhead)
    alone = msgspec.structs.replace(scenario.policy, sees="group")
    assert isinstance(policy_of(msgspec.structs.replace(scenario, policy=alone)), RelationalModel)
    nri = msgspec.structs.replace(seeing, checkpoint="us101_merge_nri")
    with pytest.raises(InputError, match="no meaning"):
        policy_of(msgspec.structs.replace(scenario, policy=nri))
