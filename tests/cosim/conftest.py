"""Short, real SUMO scenarios shared by the tests."""

from collections.abc import Iterator
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path

import msgspec
import pytest
import yaml

from cosim.loop.closed_loop import Outcome, run
from cosim.loop.driving import Driver
from cosim.process import worker_process
from cosim.process.fork import CAN_FORK
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import Scenario
from cosim.traffic.simulation_input import SumoFiles
from gri.core.policy import Policy
from gri.resources import shipped


def quiet(*_: object) -> None:
    """A listener that does not listen."""


def write_short(path: Path, **changes: object) -> Path:
    """The main scenario with a minute of warm-up and two driven seconds, as a file that people would write."""
    content = yaml.safe_load(shipped("scenarios", "us101_car_following.yaml").read_text())
    traffic = yaml.safe_load(shipped("scenarios/traffic", "us101_congested.yaml").read_text())
    traffic["warm_up"] = 60
    content |= {"traffic": traffic, "horizon": 2.0, "time_limit": 120} | changes
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.fixture(scope="module")
def forked_workers() -> Iterator[None]:
    """Runs are copies of this process, so they need not import torch and SUMO again.

    Processes that begin anew, as they do for people, are tested in tests/cosim/process and by the commands.
    """
    for module in (
        "runs.run_job",
        "runs.share_job",
        "runs.episode_figure",
        "proposals.check",
        "proposals.propose",
        "batch.run_task",
    ):
        import_module(f"cosim.{module}")
    with pytest.MonkeyPatch.context() as patch:
        if CAN_FORK:
            patch.setattr(worker_process, "get_context", lambda _: get_context("fork"))
        yield


@pytest.fixture(scope="session")
def short_scenario() -> Scenario:
    """US-101 with a minute of warm-up: traffic is there, but not settled."""
    scenario = load_scenario("us101_car_following")
    traffic = msgspec.structs.replace(scenario.traffic, warm_up=60.0)
    return msgspec.structs.replace(
        scenario, traffic=traffic, horizon=3.0, watch=1.0, episodes=6, groups_at_once=4, time_limit=120.0
    )


@pytest.fixture
def simulate(tmp_path: Path):
    """Run a scenario in this process and return its outcome."""

    def simulate(scenario: Scenario, policy: Policy | Driver | None, name: str = "test", **options: bool) -> Outcome:
        driver = Driver(name, policy) if isinstance(policy, Policy) else policy
        net = shipped("sumo_nets", scenario.net, f"{scenario.net}.net.xml")
        files = SumoFiles(net, tmp_path / "routes.rou.xml", tmp_path / "sumo.log")
        return run(scenario, files, driver, quiet, **options)

    return simulate
