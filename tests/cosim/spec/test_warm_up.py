"""Which runs share a warm-up."""

from msgspec.structs import replace

from cosim.spec.loading import load_scenario
from cosim.spec.perturbations import HeadwayRatio, LowFriction
from cosim.spec.scenario import ConstantVelocity, Idm
from cosim.spec.warm_up import warm_up_key

SCENARIO = load_scenario("us101_car_following")


def test_policies_and_perturbed_groups_share_it_and_other_traffic_does_not():
    key = warm_up_key(SCENARIO)
    close = (HeadwayRatio(intensity=0.5),)
    assert key
    assert {warm_up_key(replace(SCENARIO, policy=policy)) for policy in (Idm(), ConstantVelocity())} == {key}
    assert warm_up_key(replace(SCENARIO, perturbations=close)) == key
    others = {"seed": 2, "step": 0.1, "horizon": 5.0, "time_limit": 60.0, "net": "i80"}
    assert key not in {warm_up_key(replace(SCENARIO, **{name: value})) for name, value in others.items()}


def test_perturbed_traffic_and_no_warm_up_share_nothing():
    assert not warm_up_key(replace(SCENARIO, perturbations=(LowFriction(intensity=0.5),)))
    assert not warm_up_key(replace(SCENARIO, share=0.2))
    assert not warm_up_key(replace(SCENARIO, traffic=replace(SCENARIO.traffic, warm_up=0.0)))
