"""The calibration, on a made-up world whose best settings are known; one real evaluation."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace as replace_dataclass

import msgspec
import numpy as np
import pandas as pd
import pytest
import yaml
from msgspec.structs import replace

from cosim.spec.demand import Fluctuation, Targets, Traffic
from cosim.spec.loading import load_scenario
from cosim.studies import calibration as module
from cosim.studies.calibration import (
    COLLISION_PENALTY,
    UNLIKENESS,
    Calibration,
    Evaluation,
    Likeness,
    calibrate,
    misfit_of,
    screen,
)
from cosim.studies.free_parameters import parameters
from cosim.studies.traffic_targets import TrafficStatistics
from gri.errors import InputError


@pytest.fixture
def scenario():
    return load_scenario("us101_car_following")


def figures(speed: float, mainline: tuple[float, ...], ramp: float, collisions: int = 0) -> TrafficStatistics:
    return TrafficStatistics(1, speed, (speed,), ((speed, 1.0),), 0.0, mainline, ramp, 0.0, 0.0, 0.0, 0, collisions, 0)


def test_parameters_read_and_write_the_traffic(scenario):
    tau, limit, third = parameters(["tau", "limit", "limit.3"], scenario.traffic)
    limits = scenario.traffic.bottleneck.limits
    changed = tau.replaced_in(scenario.traffic, tau.value_in(scenario.traffic) * 1.1)
    assert [v.tau for v in changed.vehicles] == pytest.approx([1.1 * v.tau for v in scenario.traffic.vehicles])
    assert limit.replaced_in(scenario.traffic, 2 * limits[0]).bottleneck.limits == pytest.approx(
        [2 * x for x in limits]
    )
    assert third.value_in(scenario.traffic) == limits[2]
    changed = third.replaced_in(scenario.traffic, 5.0).bottleneck.limits
    assert changed[2] == 5.0
    assert changed[:2] + changed[3:] == limits[:2] + limits[3:]


@pytest.mark.parametrize("name", ["taus", "limit.0", "limit.99", "limit.x"])
def test_unknown_parameters_are_refused(scenario, name):
    with pytest.raises(InputError, match="--free: got"):
        parameters([name], scenario.traffic)


def test_misfit_by_hand(scenario):
    """Errors of 10 % and 5 % at tolerances of 10 % and 5 % count 1 each; 0 and 0 the others: 2 of 4."""
    targets = Targets(mean_speed=10.0, mainline=(1000.0, 2000.0), ramp_share=0.1)
    told = replace(scenario, traffic=replace(scenario.traffic, targets=targets))
    run = figures(11.0, (1050.0, 2000.0), 0.1)
    assert misfit_of(told, [run]) == pytest.approx(0.5)
    assert misfit_of(told, [run, figures(10.0, (1000.0, 2000.0), 0.1)]) == pytest.approx(0.25)
    assert misfit_of(told, [figures(11.0, (1050.0, 2000.0), 0.1, 1)]) == pytest.approx(0.5 + COLLISION_PENALTY)


@pytest.fixture
def made_up(monkeypatch):
    """Evaluations are replaced by a bowl with its bottom at tau 1.5 and a first limit of 14; counted."""
    calls: Counter[tuple[float, ...]] = Counter()

    def evaluate(calibration, values, executor):
        calls[values] += 1
        misfit = ((values[0] - 1.5) / 0.1) ** 2 + ((values[1] - 14.0) / 2) ** 2
        return Evaluation(values, misfit, (figures(values[1], (8000.0,), 0.06),))

    monkeypatch.setattr(module, "_evaluate", evaluate)
    return calls


def calibration_in(folder, scenario) -> Calibration:
    return Calibration(scenario, parameters(["tau", "limit"], scenario.traffic), (1,), 300.0, folder)


def quiet(*_: object) -> None:
    pass


def test_the_calibration_finds_the_bottom_and_goes_on_where_it_stopped(tmp_path, scenario, made_up):
    calibration = calibration_in(tmp_path, scenario)
    first = calibrate(calibration, 10, 1, quiet)
    assert made_up.total() == len(made_up) <= 10
    best = calibrate(calibration, 40, 1, quiet)
    assert max(made_up.values()) == 1  # nothing was evaluated twice
    assert best.misfit <= first.misfit
    assert best.values == pytest.approx((1.5, 14.0), abs=0.05)
    before = made_up.total()
    assert calibrate(calibration, 40, 1, quiet) == best
    assert made_up.total() == before
    written = msgspec.convert(yaml.safe_load((tmp_path / "traffic.yaml").read_text()), Traffic)
    assert written == calibration.traffic(best.values)


def test_another_problem_in_the_folder_is_refused(tmp_path, scenario, made_up):
    calibrate(calibration_in(tmp_path, scenario), 5, 1, quiet)
    with pytest.raises(InputError, match="calibration with other settings"):
        calibrate(calibration_in(tmp_path, replace(scenario, seed=9)), 5, 1, quiet)
    with pytest.raises(InputError, match=r"traffic\.targets"):
        calibrate(
            calibration_in(tmp_path, replace(scenario, traffic=replace(scenario.traffic, targets=None))), 5, 1, quiet
        )


@pytest.mark.slow
def test_real_evaluations_are_the_same_again(tmp_path, scenario):
    short = replace(scenario, traffic=replace(scenario.traffic, warm_up=30.0))
    one, two = (calibrate(calibration_in(tmp_path / name, short), 1, 1, quiet) for name in ("one", "two"))
    assert one == two
    assert one.runs[0].collisions == 0


def moving(scenario):
    """The scenario with a bottleneck that fluctuates."""
    bottleneck = replace(scenario.traffic.bottleneck, fluctuation=Fluctuation(sd=0.2, lane_correlation=0.9))
    return replace(scenario, traffic=replace(scenario.traffic, bottleneck=bottleneck))


def test_drivers_lane_changing_and_bottleneck_have_parameters(scenario):
    traffic = moving(scenario).traffic
    speed_gain, imperfection, spread, together = parameters(
        ["speed_gain", "imperfection", "fluctuation.sd", "fluctuation.lane_correlation"], traffic
    )
    assert [v.lane_changing.speed_gain for v in speed_gain.replaced_in(traffic, 6.0).vehicles] == [6.0, 6.0]
    assert [v.imperfection for v in imperfection.replaced_in(traffic, 0.33).vehicles] == [0.33, 0.33]
    assert spread.replaced_in(traffic, 0.3).bottleneck.fluctuation.sd == 0.3
    assert together.replaced_in(traffic, 1.2).bottleneck.fluctuation.lane_correlation == 1.0  # a share
    with pytest.raises(InputError, match=r"--free: got 'pulses.duration', this traffic has tau, tau_cv"):
        parameters(["pulses.duration"], traffic)


def test_a_class_without_the_parameter_keeps_having_none(scenario):
    """A class whose drivers do not change lanes for speed stays so."""
    (car, truck) = scenario.traffic.vehicles
    idle = replace(truck, imperfection=None, lane_changing=replace(truck.lane_changing, speed_gain=0.0))
    traffic = replace(scenario.traffic, vehicles=(idle, car))
    speed_gain, imperfection = parameters(["speed_gain", "imperfection"], traffic)
    assert speed_gain.value_in(traffic) == car.lane_changing.speed_gain
    assert [v.lane_changing.speed_gain for v in speed_gain.replaced_in(traffic, 6.0).vehicles] == [0.0, 6.0]
    assert [v.imperfection for v in imperfection.replaced_in(traffic, 0.4).vehicles] == [None, 0.4]


def test_screening_finds_what_the_made_up_world_depends_on(tmp_path, scenario, made_up):
    """The misfit is ((tau − 1.5)/.1)² + ((limit − 14)/2)²; its mean speed is the limit, whatever tau."""
    calibration = calibration_in(tmp_path, scenario)
    found = screen(calibration, 3, 0, 1, quiet)
    assert made_up.total() <= 3 * 3
    by_speed = {effect.parameter: effect.mu_star for effect in found["mean speed [m/s]"]}
    assert by_speed["tau"] == 0.0
    assert by_speed["limit"] == pytest.approx(0.5 * 15.0, rel=1e-3)  # the range is ±25 % of 15 m/s
    assert [effect.parameter for effect in found["misfit"]] == ["tau", "limit"]
    before = made_up.total()
    assert screen(calibration, 3, 0, 1, quiet) == found
    assert made_up.total() == before  # all of it was stored


def test_a_recording_adds_what_its_score_lacks(tmp_path, scenario, monkeypatch):
    """The traffic of a simulation is given: that of the recording itself, and one that is three times as fast."""
    rng = np.random.default_rng(0)
    time = np.arange(30.0)
    recorded = pd.concat(
        pd.DataFrame({"time": time, "vehicle": f"{k}", "lane": 1.0 + k % 2, "x": 9.0 * k + v * time, "v": v, "a": 0.0})
        for k, v in enumerate(rng.normal(10, 2, 20))
    ).assign(length=4.0, source="r")
    likeness = Likeness(recorded, 0.0, 1)
    calibration = replace_dataclass(calibration_in(tmp_path, scenario), likeness=likeness)
    evaluations = []
    for simulated in (recorded, recorded.assign(v=3 * recorded["v"])):
        monkeypatch.setattr(module, "_simulate", lambda *_, s=simulated: (figures(10.0, (8000.0,), 0.06), s))
        with ThreadPoolExecutor(1) as executor:
            evaluations.append(module._evaluate(calibration, (1.4, 15.0), executor))
    alike, fast = evaluations
    assert alike.score is not None
    assert fast.score is not None
    assert alike.score > fast.score + 0.2
    assert fast.misfit - alike.misfit == pytest.approx(UNLIKENESS * (alike.score - fast.score))
    assert calibration.problem != calibration_in(tmp_path, scenario).problem
