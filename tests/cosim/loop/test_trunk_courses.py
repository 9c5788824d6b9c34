"""Runs that share a trunk have the outcomes of runs alone, and each counterpart is computed once."""

import os
import pickle
import signal
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import pandas as pd
import pytest
import torch
from msgspec.structs import replace

from cosim.loop.closed_loop import follow, run
from cosim.loop.trunk import Trunk
from cosim.loop.trunk_courses import CourseLost, SharedCourse, share_trunk
from cosim.process.fork import CAN_FORK
from cosim.runs.policy_loading import driver_of
from cosim.spec.input_files import find_net
from cosim.spec.perturbations import HeadwayRatio, ObservationNoise
from cosim.spec.scenario import ConstantVelocity, Idm, LeftToSumo
from cosim.traffic.simulation_input import SumoFiles
from cosim.traffic.warm_up import warm_traffic
from tests.cosim.loop.test_closed_loop import tables_of

pytestmark = pytest.mark.skipif(not CAN_FORK, reason="this system cannot fork")

CLOSE = (HeadwayRatio(intensity=0.9),)  # some starts are infeasible
NOISY = (ObservationNoise(intensity=1.0),)  # all are feasible


@pytest.fixture
def shared(short_scenario, tmp_path, monkeypatch):
    """A way to share the trunk of the short scenario, and the rounds that were left to SUMO so far."""
    noted = tmp_path / "rounds"
    noted.touch()
    leave = Trunk.leave_to_sumo

    def noting(self, history, this_round):
        with noted.open("a") as stream:
            stream.write(f"{[group.ids for group in this_round.groups]}\n")
        return leave(self, history, this_round)

    files = SumoFiles(find_net(short_scenario.net), tmp_path / "routes.rou.xml", tmp_path / "sumo.log")
    with warm_traffic(short_scenario, files, lambda *_: None) as warm, monkeypatch.context() as patch:
        patch.setattr(Trunk, "leave_to_sumo", noting)
        yield (
            lambda may_wait=lambda: True: share_trunk(warm, driver_of, lambda: nullcontext([]), may_wait),
            lambda: noted.read_text().splitlines(),
        )


def along(root, scenario):
    return follow(SharedCourse(root, scenario), scenario, driver_of(scenario), lambda *_: None)


@pytest.mark.slow
def test_policies_and_perturbations_share_their_counterparts(short_scenario, shared, tmp_path):
    share, rounds = shared
    root, found, computed = share(), [], []
    for policy in (Idm(), ConstantVelocity(), LeftToSumo()):
        for perturbations in ((), NOISY, CLOSE):
            scenario = replace(short_scenario, policy=policy, perturbations=perturbations)
            outcome = along(root, scenario)
            found.append((scenario, outcome_parts(outcome, scenario)))
            computed.append(len(rounds()))
    assert len(set(rounds())) == len(rounds())
    assert computed[0] == computed[1] < computed[2], "noise changes no start, short headways do"
    assert computed[2] == computed[-1], "policies change none"
    chosen = [found[k] for k in (2, 3, 5, 7)]
    alone = alone_in_another_process([scenario for scenario, _ in chosen], tmp_path)
    for (_, parts), others in zip(chosen, alone, strict=True):
        for ours, theirs in zip(parts, others, strict=True):
            assert_same(ours, theirs)


def outcome_parts(outcome, scenario):
    facts = outcome.excluded, outcome.search, outcome.simulated, outcome.trunk, outcome.branches, outcome.backlog
    return [*tables_of(outcome, scenario), pd.DataFrame(outcome.effects), *facts]


def alone_in_another_process(scenarios, folder: Path):
    """Parts of the outcomes of runs alone, in a process without the simulation of the fixture."""
    (folder / "scenarios").write_bytes(pickle.dumps(scenarios))
    code = "import sys; from tests.cosim.loop.test_trunk_courses import run_alone; run_alone(sys.argv[1])"
    subprocess.run([sys.executable, "-c", code, str(folder)], check=True, timeout=900, cwd=Path(__file__).parents[3])
    return pickle.loads((folder / "parts").read_bytes())


def run_alone(folder: str) -> None:
    torch.set_num_threads(1)  # as in every process that drives: a fork has no other threads of its parent
    parts = []
    for scenario in pickle.loads(Path(folder, "scenarios").read_bytes()):
        files = SumoFiles(find_net(scenario.net), Path(folder, "r.rou.xml"), Path(folder, "sumo.log"))
        outcome = run(scenario, files, driver_of(scenario), lambda *_: None)
        parts.append(outcome_parts(outcome, scenario))
    Path(folder, "parts").write_bytes(pickle.dumps(parts))


def assert_same(ours, alone):
    if isinstance(ours, pd.DataFrame):
        pd.testing.assert_frame_equal(ours, alone, check_exact=True)
    else:
        assert ours == alone


def test_a_course_without_a_process_that_waits_is_lost(short_scenario, shared):
    """One died, or too many wait."""
    share, _ = shared
    scenario = replace(short_scenario, policy=Idm())
    with pytest.raises(CourseLost, match="too many"):
        along(share(may_wait=lambda: False), scenario)

    root = share()
    course = SharedCourse(root, scenario)
    (process,) = children_of(children_of(os.getpid())[-1])
    os.kill(process, signal.SIGKILL)
    with pytest.raises(CourseLost):
        course.leave(course.next().found.groups)


def children_of(process: int) -> list[int]:
    return [int(pid) for pid in Path(f"/proc/{process}/task/{process}/children").read_text().split()]
