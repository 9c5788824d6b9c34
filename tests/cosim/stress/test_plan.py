"""Chunks of a stress test, and what names and numbers on the command line mean."""

import pytest
from msgspec.structs import replace

from cosim.spec.loading import load_scenario
from cosim.spec.perturbations import KINDS, HeadwayRatio
from cosim.spec.scenario import ConstantVelocity, Idm, LeftToSumo, TrainedPolicy
from cosim.stress.plan import Cell, chunks, perturbed_scenario, policies_of, sweeps_of
from gri.errors import InputError
from gri.resources import find_checkpoint


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("us101_car_following")


POLICIES = {"idm": Idm(), "sumo": LeftToSumo()}


def test_what_happens_at_the_take_over_shares_one_simulation_per_seed(scenario):
    parts = chunks(scenario, POLICIES, {"headway_ratio": (0.1, 0.2), "latency": (0.4,)}, starts=24)
    assert [part.starts for part in parts] == [10, 10, 4]
    assert [part.scenario.seed for part in parts] == [1, 2, 3]
    assert parts[0].cells == (Cell(), Cell("headway_ratio", 0.1), Cell("headway_ratio", 0.2), Cell("latency", 0.4))
    assert len({part.key for part in parts}) == 3


def test_perturbed_traffic_has_a_simulation_of_its_own(scenario):
    parts = chunks(scenario, POLICIES, {"denser_demand": (1.1, 1.2)}, starts=9)
    assert [part.cells for part in parts] == [(Cell(),), (Cell("denser_demand", 1.1),), (Cell("denser_demand", 1.2),)]
    rates = [part.scenario.traffic.flows[0].per_hour[0] for part in parts]
    assert rates == pytest.approx([rates[0], 1.1 * rates[0], 1.2 * rates[0]])


def test_the_key_tells_everything_apart_that_matters(scenario):
    def key(of=scenario, policies=POLICIES, intensity=0.1, starts=8):
        return chunks(of, policies, {"latency": (intensity,)}, starts)[0].key

    assert key() == key(of=replace(scenario, description="another"))
    others = [key(of=replace(scenario, seed=7)), key(policies={"idm": Idm()}), key(intensity=0.2), key(starts=9)]
    assert len({key(), *others}) == 5


def test_rows_are_kept_by_kind_and_policy(scenario):
    """Who adds a policy, a kind or an intensity drives what is new, and nothing else."""

    def chunk(policies, sweeps):
        return chunks(scenario, policies, {"latency": (0.2, 0.4)} | sweeps, starts=8)[0]

    before = {part.key for part in chunk(POLICIES, {}).parts}
    assert len(before) == 2 * 2
    noise = {"action_noise": (1.0,)}
    for policies, sweeps, named, kinds in (
        (POLICIES | {"coasting": ConstantVelocity()}, {}, ["coasting"], ["nominal", "latency", "latency"]),
        (POLICIES, noise, ["idm", "sumo"], ["action_noise"]),
    ):
        whole = chunk(policies, sweeps)
        assert before <= {part.key for part in whole.parts}
        new = whole.covering([part for part in whole.parts if part.key not in before])
        assert list(new.policies) == named
        assert [cell.perturbation for cell in new.cells] == kinds
        assert {part.key for part in new.parts} == {part.key for part in whole.parts} - before


def test_a_cell_perturbs_a_scenario(scenario):
    assert perturbed_scenario(scenario, Cell()).perturbations == ()
    assert perturbed_scenario(scenario, Cell("headway_ratio", 0.5)).perturbations == (HeadwayRatio(intensity=0.5),)


def test_intensities_out_of_range_are_refused_before_anything_runs(scenario):
    with pytest.raises(InputError, match="<= 1"):
        chunks(scenario, POLICIES, {"dropout": (0.5, 1.5)}, 10)


def test_default_intensities(scenario):
    found = sweeps_of(["headway_ratio", "latency"], [], scenario)
    assert max(found["headway_ratio"]) < 1  # in one lane
    assert found["latency"] == KINDS["latency"].default_intensities
    assert all(len(kind.default_intensities) == 5 for kind in KINDS.values())
    assert sweeps_of(["latency"], [0.3], scenario) == {"latency": (0.3,)}


@pytest.mark.parametrize(
    ("kinds", "intensities", "message"), [(["fog"], [], "fog"), (["latency", "dropout"], [0.1], "give one kind")]
)
def test_bad_perturbations(scenario, kinds, intensities, message):
    with pytest.raises(InputError, match=message):
        sweeps_of(kinds, intensities, scenario)


def test_names_of_policies(scenario):
    found = policies_of(["gri", "supervised", "idm", "sumo"], scenario)
    assert found["gri"] == TrainedPolicy(checkpoint="us101_car_following")
    assert found["supervised"] == TrainedPolicy(checkpoint="us101_car_following_supervised")
    assert found["idm"] == Idm()
    path = str(find_checkpoint("us101_car_following_supervised"))
    assert policies_of([path], scenario) == {"us101_car_following_supervised": TrainedPolicy(checkpoint=path)}


def test_bad_policies(scenario):
    with pytest.raises(InputError, match="no checkpoint 'nobody'"):
        policies_of(["nobody"], scenario)
    with pytest.raises(InputError, match="each policy once"):
        policies_of(["idm", "idm"], scenario)
