"""Inputs of a run that are checked before SUMO sees them."""

import msgspec
import pytest

from cosim.runs.policy_loading import policy_of
from cosim.runs.run_job import run_job
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario, override
from gri.core.policy import ConstantVelocity, IntelligentDriver
from gri.errors import InputError
from gri.networks.model import RelationalModel
from gri.resources import find_checkpoint, shipped


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("us101_car_following")


@pytest.mark.parametrize("name", ["us101", "i80"])
def test_shipped_nets_are_found_by_name_and_by_path(name):
    assert find_net(name) == find_net(str(find_net(name)))


def test_unknown_net():
    with pytest.raises(InputError, match=r"no net 'us102'.*shipped name \(curved, highway, i80, us101\)"):
        find_net("us102")


def test_truncated_net_names_the_line(tmp_path):
    whole = shipped("sumo_nets/us101/us101.net.xml").read_text()
    path = tmp_path / "cut.net.xml"
    path.write_text(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"cut.net.xml:\d+: not well-formed XML"):
        find_net(str(path))


def test_another_xml_file_is_not_a_net(tmp_path):
    path = tmp_path / "routes.net.xml"
    path.write_text("<routes/>")
    with pytest.raises(InputError, match="got a <routes> file, expected a SUMO <net>"):
        find_net(str(path))


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ({"kind": "idm"}, IntelligentDriver),
        ({"kind": "constant_velocity"}, ConstantVelocity),
        ({"kind": "gri", "checkpoint": "us101_car_following"}, RelationalModel),
        ({"kind": "gri", "checkpoint": str(find_checkpoint("us101_car_following"))}, RelationalModel),
        ({"kind": "sumo"}, type(None)),
    ],
)
def test_drivers_become_policies(scenario, kind, expected):
    assert isinstance(policy_of(override(scenario, {"policy": kind})), expected)


MERGE = {"rule": "merge", "lane": "weave_0", "zone": [187.0, 350.0]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"policy": {"kind": "gri", "checkpoint": "nobody"}}, r"no checkpoint 'nobody': .*us101_car_following"),
        (
            {"step": 0.25},
            r"step: got 0.25 s, the policy acts every 0.2 s; set step to",
        ),
        ({"history": 1.0}, r"history: got 1 s, the policy wants \d+ states; set history to at least"),
        ({"group": MERGE}, r"got the edge vocabulary \(none, follow\), the group rule 'merge' wants \(none, follow, y"),
    ],
)
def test_a_policy_that_does_not_fit_is_refused(scenario, changes, message):
    with pytest.raises(InputError, match=message):
        policy_of(override(scenario, changes))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"road": {"edges": ["upstream", "midstream"], "origin": "upstream", "length": 100.0}},
            r"road.edges: the net .* has no edge 'midstream'",
        ),
        (
            {"group": {"rule": "car_following", "min_gap": 40, "max_gap": 40.1, "max_time_gap": 0.1}},
            r"no group fits the rule within 20 s; .* \(\d+ chains of three vehicles .*: \d+ gap > 40.1 m; \d+ gap",
        ),
    ],
)
def test_what_only_the_simulation_can_tell(short_scenario, tmp_path, change, message):
    scenario = override(short_scenario, {"policy": {"kind": "idm"}, "time_limit": 20.0} | change)
    with pytest.raises(InputError, match=message):
        run_job(scenario, tmp_path, lambda *_: None)


def test_demand_on_a_missing_edge_carries_sumos_message(short_scenario, tmp_path):
    traffic = short_scenario.traffic
    flow = msgspec.structs.replace(traffic.flows[0], edges=("upstream", "nowhere"))
    traffic = msgspec.structs.replace(traffic, flows=(flow, *traffic.flows[1:]))
    scenario = msgspec.structs.replace(override(short_scenario, {"policy": {"kind": "sumo"}}), traffic=traffic)
    with pytest.raises(InputError, match=r"SUMO refused the scenario: .*nowhere"):
        run_job(scenario, tmp_path, lambda *_: None)
