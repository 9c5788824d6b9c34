"""What keeps the work of a scenario bounded: ranges of fields, and the estimate of the work."""

import msgspec
import pytest

from cosim.spec.loading import load_scenario, override
from cosim.spec.scenario import Scenario
from cosim.spec.work import LIMITS, entering
from gri.errors import InputError

US101 = "us101_car_following"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rest": 1e9}, r"rest: Expected `float` <= 3600.0, got 1000000000.0"),
        ({"history": 1e6}, "history: "),
        ({"time_limit": 1e12}, "time_limit: "),
        ({"step": 1e-9}, "step: "),
        ({"episodes": 10**12}, "episodes: "),
        ({"perturbations": [{"kind": "leader_braking", "intensity": 1e18}]}, r"perturbations\[0\].intensity: "),
        ({"perturbations": [{"kind": "observation_noise", "intensity": 1e9}]}, r"perturbations\[0\].intensity: "),
        (
            {"perturbations": [{"kind": "headway_ratio", "intensity": float("nan")}]},
            "got nan, expected a finite number",
        ),
        ({"horizon": float("inf")}, "horizon: got inf, expected a finite number"),
        ({"net": "x" * 5000}, "net: Expected `str` of length <= 1000"),
    ],
)
def test_values_out_of_range_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        override(load_scenario(US101), changes)


@pytest.mark.parametrize(
    ("place", "changes", "message"),
    [
        ("traffic", {"interval": 1e-9}, "interval"),
        ("traffic", {"warm_up": 1e12}, "warm_up"),
        ("flows", {"per_hour": (1e9,)}, "per_hour"),
        ("vehicles", {"variants": 10**7}, "variants"),
        ("vehicles", {"width": 1e6}, "width"),
        ("vehicles", {"speed_factor": 1e6}, "speed_factor"),
        ("vehicles", {"length_sd": 3.0}, "some vehicles would have none; expected length_sd below"),
    ],
)
def test_traffic_out_of_range_is_refused(place, changes, message):
    content = msgspec.to_builtins(load_scenario(US101))
    holder = content["traffic"] if place == "traffic" else content["traffic"][place][0]
    holder.update(changes)
    with pytest.raises(msgspec.ValidationError, match=message):
        msgspec.convert(content, Scenario)


def test_vehicles_are_counted_over_all_intervals():
    traffic = load_scenario(US101).traffic
    first = sum(flow.per_hour[0] for flow in traffic.flows) * traffic.interval / 3600
    last = sum(flow.per_hour[-1] for flow in traffic.flows)
    assert entering(traffic, traffic.interval) == pytest.approx(first)
    assert entering(traffic, 36_000.0) - entering(traffic, 32_400.0) == pytest.approx(last)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"step": 0.02, "time_limit": 600_000.0}, "steps"),
        ({"time_limit": 600_000.0}, "steps"),
        ({"episodes": 100_000, "groups_at_once": 10}, "vehicle states in memory"),
    ],
)
def test_a_run_that_may_be_too_much_is_refused_unless_it_is_allowed(changes, what):
    scenario = load_scenario(US101)
    with pytest.raises(InputError, match=rf"may need [\d,]+ {what}, more than .* max_work: (\d+)"):
        override(scenario, changes)
    assert override(scenario, changes | {"max_work": 100.0}).max_work == 100


def test_flows_that_are_too_much_are_refused():
    content = msgspec.to_builtins(load_scenario(US101)) | {"time_limit": 86_400.0}
    content["traffic"]["flows"][0]["per_hour"] = [50_000.0]
    with pytest.raises(
        msgspec.ValidationError, match=r"may need [\d,]+ vehicles, more than 500,000; give smaller flows"
    ):
        msgspec.convert(content, Scenario)


def test_shipped_scenarios_are_far_below_the_limits():
    work = load_scenario(US101).work(3600.0)
    assert work.steps < LIMITS.steps / 20
    assert work.vehicles < LIMITS.vehicles / 20
    assert work.states < LIMITS.states / 20


def test_the_file_or_the_option_raises_the_limit(tmp_path):
    (tmp_path / "long.yaml").write_bytes(
        msgspec.yaml.encode(msgspec.to_builtins(load_scenario(US101)) | {"time_limit": 600_000.0})
    )
    with pytest.raises(InputError, match=r"long.yaml: the run may need 3,003,000 steps, more than 2,000,000"):
        load_scenario(str(tmp_path / "long.yaml"))
    assert load_scenario(str(tmp_path / "long.yaml"), max_work=4.0).max_work == 4


@pytest.mark.parametrize("size", [2, 3, 5, 8])
def test_all_but_the_leader_are_driven(size):
    scenario = override(load_scenario(US101), {"group": {"rule": "car_following", "size": size}})
    assert scenario.driven_roles == tuple(range(size - 1))


@pytest.mark.parametrize(
    ("scenario", "changes", "message"),
    [
        (US101, {"group": {"rule": "car_following", "size": 9}}, "group.size: Expected `int` <= 8"),
        (US101, {"group": {"rule": "car_following", "size": 1}}, "group.size: Expected `int` >= 2"),
        (US101, {"driven": [2]}, "expected roles from 0 to 1; the leader is 2"),
        (US101, {"group": {"rule": "car_following", "size": 2}, "driven": [0, 1]}, "expected roles from 0 to 0"),
        (US101, {"graph": {"source": "enforced", "edges": {"4->3": "none"}}}, "expected vehicles from 0 to 2"),
        (
            US101,
            {
                "group": {"rule": "car_following", "size": 4},
                "perturbations": [{"kind": "remove_third", "intensity": 0.5}],
            },
            "a group of three",
        ),
        (
            "us101_merge",
            {"group": {"rule": "merge", "lane": "weave_0", "zone": [0, 10], "size": 5}},
            "size is 5, expected 3: a merge has",
        ),
    ],
)
def test_sizes_of_groups_are_checked(scenario, changes, message):
    with pytest.raises(InputError, match=message):
        override(load_scenario(scenario), changes)


HELD = {"edges": ["entry"], "mean_speed": [11.0]}


@pytest.mark.parametrize(
    ("bottleneck", "more", "message"),
    [
        ({"hold": {**HELD, "delay": 17.0}}, {}, r"horizon and watch last 18 s together, expected at most the delay"),
        ({"hold": HELD}, {"share": 0.2}, "would undo what a share changes"),
        ({"pulses": {"lanes": ["exit_0"]}}, {}, r"pulses.lanes has 'exit_0', expected lanes of the bottleneck"),
        ({"fluctuation": {"sd": 0.1, "lane_sd": {"exit_0": 0.2}}}, {}, "fluctuation.lane_sd has 'exit_0'"),
    ],
)
def test_moving_limits_that_do_not_fit_the_rest_are_refused(bottleneck, more, message):
    content = msgspec.to_builtins(load_scenario(US101)) | more
    content["traffic"]["bottleneck"].update(bottleneck)
    with pytest.raises(msgspec.ValidationError, match=message):
        msgspec.convert(content, Scenario)
