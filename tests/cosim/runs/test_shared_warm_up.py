"""Runs that share a warm-up have the results of runs alone."""

import dataclasses
from collections import deque

import pytest
from msgspec.structs import replace

from cosim.batch.run_matrix import key_of
from cosim.process.task import Preparation, Task
from cosim.process.task_pool import run_local
from cosim.spec.perturbations import HeadwayRatio
from cosim.spec.scenario import ConstantVelocity, Idm
from cosim.spec.warm_up import warm_up_key


@pytest.mark.slow
def test_every_file_has_the_bytes_of_a_run_alone(short_scenario, tmp_path):
    """Also SUMO's log, which begins with what it said during the warm-up."""
    short = replace(short_scenario, episodes=2, horizon=1.0, watch=0.4)
    close = replace(short, policy=ConstantVelocity(), perturbations=(HeadwayRatio(intensity=0.25),))
    scenarios = {"idm": replace(short, policy=Idm()), "close": close}
    shared = Preparation(warm_up_key(short), "cosim.runs.shared_warm_up:shared_warm_up", (short,))
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
    answers = list(run_local(queue, 300.0, workers=1))
    assert [answer.kind for answer in answers] == ["done"] * 4, [answer.message for answer in answers]
    for name in scenarios:
        files = {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()}
        assert len(files) > 6
        assert files == {path.name: path.read_bytes() for path in (tmp_path / f"{name}_alone").iterdir()}
