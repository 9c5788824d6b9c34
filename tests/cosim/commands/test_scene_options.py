"""What a person may type wrongly."""

import pytest

from cosim.commands.scene_options import changed, kinds_of, rules_of, with_car_following
from cosim.spec.loading import load_scenario
from gri.errors import InputError


def test_kinds_are_named_once_and_in_order():
    assert kinds_of(None) == ("car_following", "merge")
    assert kinds_of(["merge", "merge"]) == ("merge",)
    with pytest.raises(InputError, match="--kind: got 'weave', wanted one of car_following, merge, triple"):
        kinds_of(["weave"])


@pytest.mark.parametrize("jitter", [-0.2, 2.6])
def test_a_jitter_leaves_the_lane_change_in_the_scene(jitter):
    assert rules_of(at_most=[], jitter=2.4).jitter == 2.4
    with pytest.raises(InputError, match=r"--jitter: got .* s, wanted 0 to 2\.4 s"):
        rules_of(at_most=[], jitter=jitter)


def test_groups_of_other_sizes_are_chains():
    assert kinds_of(None, 5) == ("car_following",)
    assert kinds_of(["car_following"], 2) == ("car_following",)
    with pytest.raises(InputError, match=r"--kind: got merge for group\.size 5, but a merge has three vehicles; set"):
        kinds_of(["car_following", "merge"], 5)


def test_rules_take_what_is_given():
    rules = rules_of(at_most=["follow=0.5", "cut_in=0.25"], spacing=30.0, interaction=None, reduction="longest")
    assert rules.at_most == {"follow": 0.5, "cut_in": 0.25}
    assert rules.spacing == 30
    assert rules.interaction == 1.0
    assert rules.reduction == "longest"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"at_most": ["follow=2"]}, "--at-most: got 2 for follow, wanted a share from 0 to 1"),
        ({"at_most": ["swerve=0.5"]}, "--at-most"),
        ({"at_most": ["follow"]}, "--at-most"),
        ({"at_most": [], "reduction": "weakest"}, "--reduction"),
    ],
)
def test_mistakes_are_named(options, message):
    with pytest.raises(InputError, match=message):
        rules_of(**options)


def test_steps_must_fit():
    scenario = load_scenario("us101_merge")
    assert changed(scenario, "us101_merge", 0.05).step == 0.05
    for step in (0.15, 0.4):
        with pytest.raises(InputError, match=r"of which 0\.2 s is a multiple"):
            changed(scenario, "us101_merge", step)
    with pytest.raises(InputError, match="gri ngsim scenes"):
        changed(load_scenario("us101_replay"), "us101_replay", None)


def test_all_drivers_get_another_car_following_model():
    scenario = load_scenario("us101_merge")
    drivers = with_car_following(scenario, "EIDM").traffic.vehicles
    assert {(of.car_following, of.imperfection) for of in drivers} == {("EIDM", None)}
    assert with_car_following(scenario, None) == with_car_following(scenario, "Krauss") == scenario
    with pytest.raises(InputError, match="wanted Krauss, IDM, EIDM"):
        with_car_following(scenario, "Gipps")
