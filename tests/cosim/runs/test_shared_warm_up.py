"""Runs that share a warm-up and a trunk have the results of runs alone."""

import dataclasses
import os
import signal
from collections import deque
from contextlib import contextmanager
from pathlib import Path

import pytest
from msgspec.structs import replace

from cosim.batch.run_matrix import key_of
from cosim.process.task import Preparation, Task
from cosim.process.task_pool import run_local
from cosim.runs.shared_warm_up import shared_warm_up
from cosim.spec.perturbations import HeadwayRatio
from cosim.spec.scenario import ConstantVelocity, Idm, LeftToSumo, TrainedPolicy
from cosim.spec.warm_up import warm_up_key


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("preparation", ["cosim.runs.shared_warm_up:shared_warm_up", f"{__name__}:dying_trunk"])
def test_every_file_has_the_bytes_of_a_run_alone(short_scenario, tmp_path, workers, preparation):
    """Also where no process waits any more. SUMO's log has the same lines: alone, trunk and branches write at once."""
    short = replace(short_scenario, episodes=5, groups_at_once=2, horizon=1.0, watch=0.4)
    close = (HeadwayRatio(intensity=0.9),)
    gri = TrainedPolicy(checkpoint="us101_car_following")
    policies = {"gri": gri, "idm": Idm(), "still": ConstantVelocity(), "sumo": LeftToSumo()}
    scenarios = {name: replace(short, policy=policy) for name, policy in policies.items()}
    scenarios |= {f"{name}_close": replace(scenario, perturbations=close) for name, scenario in scenarios.items()}
    if "dying" in preparation or workers == 2:
        scenarios = {name: scenarios[name] for name in ("still", "idm_close")}
    shared = Preparation(warm_up_key(short), preparation, (short, "", *scenarios.values()))
    together = [
        Task(
            name,
            "cosim.batch.run_task:run_task",
            (scenario, {"policy": name}, key_of(scenario, {"policy": name})),
            tmp_path / name,
        )
        for name, scenario in scenarios.items()
    ]
    alone = [dataclasses.replace(task, folder=tmp_path / f"{task.name}_alone") for task in together]
    queue = deque([*(dataclasses.replace(task, preparation=shared) for task in together), *alone])
    answers = list(run_local(queue, 300.0, workers=workers))
    assert {answer.kind for answer in answers} == {"done"}, [answer.message for answer in answers]
    for name in scenarios:
        files = contents(tmp_path / name)
        assert len(files) > 6
        assert files == contents(tmp_path / f"{name}_alone")
    assert len({contents(tmp_path / name)["groups.parquet"] for name in scenarios}) == len(scenarios)


@contextmanager
def dying_trunk(scenario, within, *policies):
    """Shared traffic whose trunk has died."""
    with shared_warm_up(scenario, within, *policies) as shared:
        me = os.getpid()
        for process in Path(f"/proc/{me}/task/{me}/children").read_text().split():
            os.kill(int(process), signal.SIGKILL)
        yield shared


def contents(folder: Path) -> dict[str, object]:
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    return files | {"sumo.log": sorted(files["sumo.log"].splitlines())}
