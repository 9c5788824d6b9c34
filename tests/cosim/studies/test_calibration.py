"""The calibration, on a made-up world whose best settings are known; one real evaluation."""

from collections import Counter

import msgspec
import pytest
import yaml
from msgspec.structs import replace

from cosim.spec.demand import Targets, Traffic
from cosim.spec.loading import load_scenario
from cosim.studies import calibration as module
from cosim.studies.calibration import COLLISION_PENALTY, Calibration, Evaluation, calibrate, misfit_of, parameters
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
