"""Policies that drive shares of the traffic: who is driven, what is commanded, and what becomes of it."""

from collections.abc import Mapping
from pathlib import Path

import libsumo
import numpy as np
import pytest
import torch
from msgspec.structs import replace

from cosim.loop.pair_policy import PlainPairs, pair_policy
from cosim.loop.share_of_traffic import DrivenTraffic, ShareOutcome, SharePlan, chosen, drawn, drive_shares
from cosim.loop.speed_share import last_moment_speed
from cosim.spec.scenario import Inferred, Scenario
from cosim.spec.sumo_models import SumoModel
from cosim.traffic.driver_model_types import with_model_types
from cosim.traffic.running_simulation import simulation
from cosim.traffic.simulation_input import SimulationInput, SumoFiles, prepare_simulation
from gri import checkpoint
from gri.core.policy import ConstantVelocity, IntelligentDriver
from gri.resources import shipped
from tests.cosim.conftest import quiet

IDM = SharePlan(0.3, PlainPairs(IntelligentDriver(0.2)))


def prepared(scenario: Scenario, folder: Path, duration: float, plans: Mapping[str, SharePlan]) -> SimulationInput:
    net = shipped("sumo_nets", scenario.net, f"{scenario.net}.net.xml")
    inputs = prepare_simulation(scenario, SumoFiles(net, folder / "r.rou.xml", folder / "sumo.log"), duration)
    inputs = with_model_types(inputs, {n: p.drives for n, p in plans.items() if isinstance(p.drives, SumoModel)})
    inputs.write()
    return inputs


@pytest.fixture
def early(short_scenario: Scenario) -> Scenario:
    """US-101 while it fills: 20 s without and 30 s with recording."""
    return replace(short_scenario, traffic=replace(short_scenario.traffic, warm_up=20.0), share=0.0, surroundings=False)


@pytest.fixture
def share(early: Scenario, tmp_path: Path):
    """Run shares of the filling road."""

    def share(plans: Mapping[str, SharePlan], duration: float = 30.0, bounded: bool = True) -> ShareOutcome:
        return drive_shares(prepared(early, tmp_path, duration, plans), plans, quiet, bounded=bounded)

    return share


def positions() -> list[tuple[str, tuple[float, float], float, str]]:
    api = libsumo.vehicle
    return [(v, api.getPosition(v), api.getSpeed(v), api.getLaneID(v)) for v in api.getIDList()]


@torch.inference_mode()
def test_a_share_of_nothing_is_the_null_run_bit_for_bit(early: Scenario, tmp_path: Path) -> None:
    def traffic(share: float | None) -> list[list[tuple[str, tuple[float, float], float, str]]]:
        plans = {} if share is None else {"gri": replace_share(share)}
        with simulation(prepared(early, tmp_path, 30.0, {})) as running:
            driven, found = DrivenTraffic(running, plans, 1, 0.2, bounded=True), []
            for _ in range(200):
                running.world.step() if share is None else driven.step()
                found.append(positions())
            return found

    def replace_share(share: float) -> SharePlan:
        return SharePlan(share, pair_policy(checkpoint.load("us101_car_following"), Inferred()), 10)

    null = traffic(None)
    assert len(null[-1]) > 50
    assert traffic(0.0) == null
    assert traffic(0.2) != null


def test_vehicles_driven_at_a_small_share_are_driven_at_every_larger_one() -> None:
    vehicles = [f"through.{k}" for k in range(4000)]
    draws = {vehicle: drawn(vehicle, 7) for vehicle in vehicles}
    few, many = (
        {v for v in vehicles if chosen(draws[v], {"idm": SharePlan(part, IDM.drives)}) == "idm"} for part in (0.1, 0.4)
    )
    assert few < many
    assert len(few) / len(vehicles) == pytest.approx(0.1, abs=0.02)
    assert len(many) / len(vehicles) == pytest.approx(0.4, abs=0.03)
    two = {"a": SharePlan(0.5, IDM.drives), "b": SharePlan(0.5, IDM.drives)}
    assert {chosen(draw, two) for draw in draws.values()} == {"a", "b"}
    assert draws != {vehicle: drawn(vehicle, 8) for vehicle in vehicles}


def test_speeds_are_exactly_those_commanded_or_bounded_by_sumo_and_nobody_is_touched_or_lost(share) -> None:
    outcome = share({"idm": IDM})
    counts = outcome.counts["idm"]
    assert counts.commanded > 2000
    assert counts.largest_error == 0.0
    assert counts.bounded_by_sumo < 0.2 * counts.commanded  # the road is nearly free: the speed limit binds
    assert outcome.recording.events == ()
    assert np.mean([outcome.driver_of.get(v) == "idm" for v in outcome.recording.samples["vehicle"].unique()]) > 0.2


class Eager(ConstantVelocity):
    """Accelerates with 1.5 m/s² whoever is ahead."""

    def act(self, memory, state):
        return (1.5 - state[..., -1:]) / self.dt, memory


def test_the_last_moment_bound_keeps_a_policy_that_never_brakes_from_hitting_anybody(share) -> None:
    eager = {"eager": SharePlan(0.3, PlainPairs(Eager(0.2)))}
    bounded, free = share(eager, 15.0), share(eager, 15.0, bounded=False)
    assert [e.kind for e in bounded.recording.events if e.kind == "contact"] == []
    assert bounded.counts["eager"].last_moment > 0
    assert "contact" in {e.kind for e in free.recording.events}


def test_behind_a_vehicle_that_brakes_as_hard_as_it_can_the_bound_is_just_enough() -> None:
    """In the steps of SUMO, speed first: no contact with the bound, a contact with 5 % more."""
    rng = np.random.default_rng(0)
    n, dt = 500, 0.2
    braking, v_ahead = rng.uniform(4, 9, n), rng.uniform(0, 30, n)
    gap = rng.uniform(0.6, 40, n)
    smallest = {}
    for factor in (1.0, 1.05):
        v, ahead, left = factor * last_moment_speed(gap, v_ahead, braking, dt), v_ahead, gap.copy()
        closest = np.full(n, np.inf)
        for _ in range(100):
            ahead = np.maximum(ahead - braking * dt, 0)
            left = left + (ahead - v) * dt
            closest = np.minimum(closest, left)
            v = np.maximum(v - braking * dt, 0)
        smallest[factor] = closest.min()
    assert smallest[1.0] > 0.2
    assert smallest[1.05] < 0


def test_one_of_sumos_models_replaces_that_of_a_vehicle_and_keeps_its_body(early: Scenario, tmp_path: Path) -> None:
    plans = {"acc": SharePlan(1.0, SumoModel(model="ACC", parameters={"tau": 0.9}))}
    with simulation(prepared(early, tmp_path, 10.0, plans)) as running:
        driven, api = DrivenTraffic(running, plans, 1, 0.2, bounded=True), libsumo.vehicle
        for _ in range(100):
            driven.step()
        vehicle = api.getIDList()[0]
        assert api.getTypeID(vehicle) == f"share.acc@{vehicle}"
        assert libsumo.vehicletype.getParameter(api.getTypeID(vehicle), "carFollowModel") in ("", "ACC")
        assert api.getTau(vehicle) == 0.9
        assert api.getParameter(vehicle, "laneChangeModel.lcStrategic") == "3.00"
        lengths = {api.getLength(v) for v in api.getIDList()}
        assert len(lengths) > 5  # the bodies of the demand, not those of the type


def test_vehicles_of_a_policy_that_fails_are_left_to_sumo_and_the_run_goes_on(share) -> None:
    class Broken(IntelligentDriver):
        def act(self, memory, state):
            return super().act(memory, state * np.nan)

    outcome = share({"broken": SharePlan(0.5, PlainPairs(Broken(0.2)))}, 5.0)
    assert "finite" in outcome.failures["broken"]
    assert [event.kind for event in outcome.recording.events] == ["policy_failed"]
    assert outcome.counts["broken"].commanded == 0
