"""Chunks of a stress test, and what names and numbers on the command line mean."""

import pytest
from msgspec.structs import replace

from cosim.spec.loading import load_scenario
from cosim.spec.perturbations import KINDS, HeadwayRatio
from cosim.spec.scenario import ConstantVelocity, Driver, Idm, LeftToSumo, Replay, RssFilter, TrainedPolicy, UserPolicy
from cosim.stress.plan import Cell, chunks, perturbed_scenario, policies_of, scenario_for, senseless, sweeps_of
from gri.errors import InputError
from gri.resources import find_checkpoint


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("us101_car_following")


POLICIES = {"idm": Idm(), "sumo": LeftToSumo()}


def test_what_happens_at_the_take_over_shares_one_simulation_per_seed(scenario):
    parts = chunks(scenario, POLICIES, {"headway_ratio": (0.1, 0.2), "action_delay": (0.4,)}, starts=24)
    assert [part.starts for part in parts] == [10, 10, 4]
    assert [part.scenario.seed for part in parts] == [1, 2, 3]
    assert parts[0].cells == (Cell(), Cell("headway_ratio", 0.1), Cell("headway_ratio", 0.2), Cell("action_delay", 0.4))
    assert len({part.key for part in parts}) == 3


def test_perturbed_traffic_has_a_simulation_of_its_own(scenario):
    parts = chunks(scenario, POLICIES, {"denser_traffic": (1.1, 1.2)}, starts=9)
    assert [part.cells for part in parts] == [(Cell(),), (Cell("denser_traffic", 1.1),), (Cell("denser_traffic", 1.2),)]
    limits = [part.scenario.traffic.bottleneck.limits[0] for part in parts]
    assert limits[0] > limits[1] > limits[2]
    assert [part.unperturbed for part in parts] == [None, scenario.traffic, scenario.traffic]


def test_the_key_tells_everything_apart_that_matters(scenario):
    def key(of=scenario, policies=POLICIES, intensity=0.1, starts=8):
        return chunks(of, policies, {"action_delay": (intensity,)}, starts)[0].key

    assert key() == key(of=replace(scenario, description="another"))
    others = [key(of=replace(scenario, seed=7)), key(policies={"idm": Idm()}), key(intensity=0.2), key(starts=9)]
    assert len({key(), *others}) == 5


def test_rows_are_kept_by_kind_and_policy(scenario):
    """Who adds a policy, a kind or an intensity drives what is new, and nothing else."""

    def chunk(policies, sweeps):
        return chunks(scenario, policies, {"action_delay": (0.2, 0.4)} | sweeps, starts=8)[0]

    before = {part.key for part in chunk(POLICIES, {}).parts}
    assert len(before) == 2 * 2
    noise = {"action_noise": (1.0,)}
    for policies, sweeps, named, kinds in (
        (POLICIES | {"coasting": ConstantVelocity()}, {}, ["coasting"], ["nominal", "action_delay", "action_delay"]),
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
    found = sweeps_of(["headway_ratio", "action_delay"], [], scenario)
    assert max(found["headway_ratio"]) < 1  # in one lane
    assert found["action_delay"] == KINDS["action_delay"].default_intensities
    assert all(len(kind.default_intensities) == 5 for kind in KINDS.values())
    assert sweeps_of(["action_delay"], [0.3], scenario) == {"action_delay": (0.3,)}


def test_kinds_with_intensities_of_their_own(scenario):
    found = sweeps_of(["leader_braking:4:8", "dropout:0.2", "action_delay"], [], scenario, levels=1)
    assert found == {"leader_braking": (4.0, 8.0), "dropout": (0.2,), "action_delay": (1.0,)}


def test_all_kinds_are_all_that_make_sense(scenario):
    found = sweeps_of(["all"], [], scenario)
    assert list(found) == list(KINDS)
    assert all(len(intensities) == 2 for intensities in found.values())
    assert found["action_delay"] == (0.4, 1.0)
    assert sweeps_of(["all"], [], scenario, levels=5)["action_delay"] == KINDS["action_delay"].default_intensities
    recorded = replace(scenario, background=Replay(lane_1=1.8))
    left_out = {"denser_traffic", "more_trucks", "aggressive_drivers"}
    assert set(senseless(recorded)) == left_out
    assert set(sweeps_of(["all"], [], recorded)) == set(KINDS) - left_out
    flows = tuple(replace(flow, classes={"car": 1.0}) for flow in scenario.traffic.flows)
    without_trucks = replace(scenario, traffic=replace(scenario.traffic, flows=flows))
    assert set(senseless(without_trucks)) == {"more_trucks"}
    with pytest.raises(InputError, match="no flow has trucks"):
        sweeps_of(["more_trucks"], [], without_trucks)


def test_the_graph_is_inferred_again_in_a_stress_test(scenario):
    """Otherwise perturbed sensors would reach the first inference only."""

    def reinfer(of, given=None):
        return chunks(of, POLICIES, {}, 1, reinfer_s=given)[0].scenario.reinfer_s

    assert scenario.reinfer_s == 0
    assert reinfer(scenario) == 1.0
    assert reinfer(replace(scenario, reinfer_s=2.0)) == 2.0
    assert reinfer(scenario, 0.0) == 0
    with pytest.raises(InputError, match="multiple of step"):
        reinfer(scenario, 0.3)


@pytest.mark.parametrize(
    ("kinds", "intensities", "message"),
    [
        (["fog"], [], "fog"),
        (["latency"], [], "perception_latency"),
        (["action_delay", "dropout"], [0.1], "give one kind"),
        (["action_delay:0.2", "dropout"], [0.1], "leave one of them out"),
        (["all", "dropout:0.2"], [], "dropout and all"),
        (["dropout:"], [], "got '' as an intensity"),
        (["dropout:nan"], [], "finite"),
        (["dropout:0.2", "dropout"], [], "each one once"),
        (["dropout:0.2:0.2"], [], "each one once"),
    ],
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


def test_additions_to_names_change_the_scenario(scenario):
    names = ["gri+predict+rss", "idm+rss", "gri+predict"]
    found = {name: scenario_for(name, driver, scenario) for name, driver in policies_of(names, scenario).items()}
    assert list(found) == names
    both, filtered, predicting = found.values()
    assert both.policy == TrainedPolicy(checkpoint="us101_car_following")
    assert (both.safety, both.predictor) == (RssFilter(), "constant_acceleration")
    assert (filtered.policy, filtered.safety, filtered.predictor) == (Idm(), RssFilter(), "none")
    assert (predicting.safety, predicting.predictor) == (None, "constant_acceleration")
    for name in ("sumo+rss", "sumo+predict"):
        with pytest.raises(InputError, match="write sumo"):
            policies_of([name], scenario)


def test_a_policy_of_ones_own_counts_with_the_files_of_its_settings(scenario, tmp_path):
    (tmp_path / "mine.py").write_text("class Mine: ...")
    (tmp_path / "net.npz").write_text("weights")
    settings = {"file": str(tmp_path / "net.npz"), "gain": 2}
    own = replace(scenario, policy=UserPolicy(object=f"{tmp_path / 'mine.py'}:Mine", settings=settings))
    found = policies_of(["own", "idm"], own)
    assert found == {"own": own.policy, "idm": Idm()}
    (chunk,) = chunks(own, {"own": own.policy}, {}, 2)
    before = chunk.key
    (tmp_path / "net.npz").write_text("other weights")
    assert chunk.key != before
    with pytest.raises(InputError, match="the policy of the scenario is gri"):
        policies_of(["own"], scenario)


def test_bad_policies(scenario):
    with pytest.raises(InputError, match="no checkpoint 'nobody'"):
        policies_of(["nobody"], scenario)
    with pytest.raises(InputError, match="each policy once"):
        policies_of(["idm", "idm"], scenario)


def test_trained_policies_see_as_much_as_the_one_that_the_scenario_names():
    scenario = load_scenario("us101_merge")  # sees everybody
    found = policies_of(["gri", "supervised+rss", "nri"], scenario)
    assert _seen(found) == {"gri": "everybody", "supervised+rss": "everybody", "nri": "group"}  # NRI cannot
    alone = replace(scenario, policy=TrainedPolicy(checkpoint="us101_merge", sees="group"))
    assert _seen(policies_of(["gri", "supervised+rss", "nri"], alone)) == dict.fromkeys(found, "group")


def test_ahead_after_a_name_lets_a_trained_policy_see_everybody():
    scenario = load_scenario("us101_car_following")  # sees its group
    found = policies_of(["gri", "gri+ahead", "us101_merge_supervised+ahead+rss"], scenario)
    assert _seen(found) == {"gri": "group", "gri+ahead": "everybody", "us101_merge_supervised+ahead+rss": "everybody"}
    with pytest.raises(InputError, match="only trained policies"):
        policies_of(["idm+ahead"], scenario)


def _seen(policies: dict[str, Driver]) -> dict[str, str]:
    return {name: policy.sees for name, policy in policies.items() if isinstance(policy, TrainedPolicy)}
