"""Changes of a scenario that options give: what `--set FIELD=VALUE` means, and what it refuses."""

import pytest
from msgspec import to_builtins

from cosim.runs.run import run
from cosim.spec.loading import load_scenario
from cosim.spec.settings import overlay, settings_of
from gri.errors import InputError


def test_values_are_yaml_and_fields_are_nested() -> None:
    texts = ["group.max_gap=20", "group.min_gap = 1.5", "surroundings=false", "perturbations=[{kind: dropout}]"]
    assert settings_of(texts) == {
        "group": {"max_gap": 20, "min_gap": 1.5},
        "surroundings": False,
        "perturbations": [{"kind": "dropout"}],
    }


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (["horizon"], "expected FIELD=VALUE"),
        (["=3"], "expected FIELD=VALUE"),
        (["group..max_gap=3"], "expected FIELD=VALUE"),
        (["horizon=3", "horizon=4"], "horizon is given twice"),
        (["group={}", "group.max_gap=3"], None),
        (["group=3", "group.max_gap=3"], "inside a field that is given"),
        (["group.max_gap=3", "group=3"], "group is given twice"),
        (["horizon=[1"], "not valid YAML"),
        (["horizon=!!python/object:os.system"], "--set horizon"),
    ],
)
def test_a_wrong_setting_is_refused(texts: list[str], words: str | None) -> None:
    if words is None:
        assert settings_of(texts) == {"group": {"max_gap": 3}}
        return
    with pytest.raises(InputError, match=words):
        settings_of(texts)


def test_a_mapping_with_a_kind_replaces_the_old_one() -> None:
    old = {"policy": {"kind": "gri", "checkpoint": "a"}, "group": {"rule": "merge", "max_gap": 30}}
    changes = {"policy": {"kind": "idm"}, "group": {"max_gap": 20}}
    assert overlay(old, changes) == {"policy": {"kind": "idm"}, "group": {"rule": "merge", "max_gap": 20}}


def test_a_scenario_differs_in_the_fields_set_and_in_nothing_else() -> None:
    plain = to_builtins(load_scenario("us101_car_following"))
    settings = ["group.max_gap=20", "horizon=4", "policy.kind=idm", "max_work=2"]
    settled = to_builtins(load_scenario("us101_car_following", settings=settings))
    assert plain["group"]["max_gap"] != 20
    assert settled["group"] == {**plain["group"], "max_gap": 20}
    assert (settled["horizon"], settled["policy"]["kind"], settled["max_work"]) == (4, "idm", 2)
    same = set(plain) - {"group", "horizon", "policy", "max_work"}
    assert {name: settled[name] for name in same} == {name: plain[name] for name in same}


def test_the_traffic_can_be_the_name_of_a_traffic_file() -> None:
    i80 = load_scenario("i80_car_following").traffic
    assert load_scenario("us101_car_following", settings=["traffic=i80_congested"]).traffic == i80


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("group.max_gp=20", r"^--set: field group.max_gp: unknown field; did you mean 'max_gap'\?"),
        ("perturbations=[{kind: leader_braking, deceleration: 3}]", r"\[0\].deceleration: .*; expected one of inten"),
        ("policy={kind: idm, headway: 1}", r"policy.headway: unknown field; expected one of kind, sees$"),
        ("horizon=-1", r"^--set: field horizon: expected .*, got -1; give a value in this range"),
        ("horizon=.inf", r"^--set"),
        ("max_work=x", r"^--set: field max_work"),
        ("traffic=nowhere", "unknown traffic 'nowhere'"),
    ],
)
def test_a_setting_that_does_not_fit_is_named(setting: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        load_scenario("us101_car_following", settings=[setting])


def test_the_python_door_takes_the_same_settings() -> None:
    with pytest.raises(InputError, match=r"^--set: field group.max_gp"):
        run("us101_car_following", settings=["group.max_gp=20"])
