"""Effects of perturbed traffic: the state by hand, what is stated, and simulations of one seed compared."""

import msgspec
import numpy as np
import pandas as pd
import pytest

from cosim.perturb.effects import effects_table
from cosim.runs.traffic_effects import TrafficState, compared_traffic, survey_traffic, traffic_effects, traffic_state
from cosim.runs.traffic_survey import Survey
from cosim.spec.loading import load_scenario
from cosim.spec.perturbations import KINDS, HeadwayRatio

CALM = TrafficState(flow=9000.0, density=200.0, speed=12.5, waiting=2, hardest_braking=-5.0, shares={"car": 1.0})


def under(scenario, **kinds: float):
    return msgspec.structs.replace(scenario, perturbations=tuple(KINDS[kind](intensity=x) for kind, x in kinds.items()))


def quiet(*_: object) -> None:
    """Ignores progress."""


def test_flow_density_and_speed_are_those_of_edie():
    """Two seconds with two vehicles and one on 640 m: n/L = 1.5/0.64 km; Σv/L = (10 + 20 + 12)/2 s/640 m."""
    rows = [(601.0, "a", "car", 10.0), (601.0, "b", "truck", 20.0), (602.0, "b", "truck", 12.0)]
    samples = pd.DataFrame(rows, columns=["time", "vehicle", "kind", "v"])
    state = traffic_state(load_scenario("us101_car_following"), Survey(samples, -3.0, 7, 0, 0))
    assert state.density == pytest.approx(1.5 / 0.64)
    assert state.flow == pytest.approx(3600 * 21 / 640)
    assert state.speed == pytest.approx(14.0)  # = 42 m/s shared by three samples
    assert state.shares == {"car": 0.5, "truck": 0.5}
    assert (state.waiting, state.hardest_braking) == (7, -3.0)


def test_denser_traffic_states_its_density_and_says_when_the_road_is_full():
    scenario = under(load_scenario("us101_car_following"), denser_traffic=1.25)
    full = TrafficState(8700.0, 210.0, 11.5, 496, -5.0, {"car": 1.0})
    table = effects_table(compared_traffic(scenario, CALM, full)).set_index("quantity")
    assert table.loc["density", ["stated", "measured", "unperturbed"]].tolist() == [250.0, 210.0, 200.0]
    assert table.loc["density", "remark"] == "the road is full: 496 vehicles wait outside"
    assert np.isnan(table.loc["mean speed", "stated"])
    free = TrafficState(8700.0, 250.0, 9.7, 5, -5.0, {"car": 1.0})
    assert set(effects_table(compared_traffic(scenario, CALM, free))["remark"]) == {""}


def test_other_drivers_state_their_share_and_the_speed_they_keep():
    scenario = under(load_scenario("us101_car_following"), aggressive_drivers=1.0)
    after = TrafficState(12300.0, 297.0, 11.6, 2, -9.0, {"aggressive_car": 0.97, "truck": 0.03})
    table = effects_table(compared_traffic(scenario, CALM, after)).set_index("quantity")
    assert table.loc["mean speed", "stated"] == 12.5
    assert table.loc["share of car", ["stated", "measured", "unperturbed"]].tolist() == [0, 0, 1]
    assert table.loc["share of aggressive_car", "stated"] == pytest.approx(0.97, abs=0.01)


def test_other_perturbations_have_no_effect_on_the_traffic():
    scenario = msgspec.structs.replace(load_scenario("us101_merge"), perturbations=(HeadwayRatio(intensity=0.5),))
    assert traffic_effects(scenario, quiet) == []


@pytest.fixture(scope="module")
def short():
    scenario = load_scenario("i80_car_following")
    traffic = msgspec.structs.replace(scenario.traffic, warm_up=60.0, interval=60.0)
    return msgspec.structs.replace(scenario, traffic=traffic, time_limit=60.0)


def test_the_neutral_intensity_gives_the_very_same_traffic(short):
    """The negative control, with all kinds at once."""
    neutral = under(short, denser_traffic=1.0, more_trucks=0.0, aggressive_drivers=0.0, low_friction=1.0)
    assert survey_traffic(short, quiet) == survey_traffic(neutral, quiet)


def test_simulated_drivers_have_the_stated_shares_and_brake_within_the_friction(short, tmp_path):
    both = under(short, aggressive_drivers=0.5, low_friction=0.2)
    table = effects_table(traffic_effects(both, quiet, tmp_path)).set_index(["perturbation", "quantity"])
    share = table.loc[("aggressive_drivers", "share of aggressive_car")]
    assert share["measured"] == pytest.approx(share["stated"], abs=0.06)
    assert share["unperturbed"] == 0
    braking = table.loc[("low_friction", "hardest braking of SUMO's drivers")]
    assert braking["stated"] == pytest.approx(-1.962)
    assert braking["unperturbed"] < -1.962 < braking["measured"] + 1e-6
    assert len(list(tmp_path.glob("traffic-*.json"))) == 2  # kept for the next chunk of the same seed
    again = effects_table(traffic_effects(both, quiet, tmp_path)).set_index(["perturbation", "quantity"])
    pd.testing.assert_frame_equal(table, again)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["us101_car_following", "i80_car_following", "curved_merge"])
def test_denser_traffic_reaches_its_density_without_a_queue_outside(name):
    """In the shipped traffic, within 5 % and with at most 20 vehicles more outside."""
    scenario = load_scenario(name)
    before, after = (survey_traffic(of, quiet) for of in (scenario, under(scenario, denser_traffic=1.25)))
    assert after.density == pytest.approx(1.25 * before.density, rel=0.05)
    assert after.waiting <= before.waiting + 20


@pytest.mark.slow
def test_aggressive_drivers_do_not_dissolve_the_queue():
    """Version 0.1: 25.7 m/s instead of 13.1 m/s."""
    scenario = load_scenario("us101_car_following")
    before, after = (survey_traffic(of, quiet) for of in (scenario, under(scenario, aggressive_drivers=1.0)))
    assert after.speed == pytest.approx(before.speed, rel=0.2)
    assert after.waiting <= before.waiting + 20
