"""Tasks on a stand-in for Ray, which calls functions at once and in this process."""

import sys
from collections import deque
from types import SimpleNamespace

import pytest

from cosim.process.ray_pool import run_ray
from cosim.process.remote_task import end_worker
from gri.errors import InputError
from tests.cosim.process.conftest import tasks


class RayError(Exception):
    pass


@pytest.fixture
def ray(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    results: dict[int, object] = {}

    def call(function, arguments) -> int:
        results[len(results)] = function(*arguments)
        return len(results) - 1

    def get(reference: int) -> object:
        return results[reference]

    module = SimpleNamespace(
        init=lambda **_: None,
        shutdown=lambda: None,
        cluster_resources=lambda: {"CPU": 1},
        remote=lambda **_: lambda function: SimpleNamespace(remote=lambda *arguments: call(function, arguments)),
        wait=lambda waiting, num_returns, timeout: (waiting[:num_returns], waiting[num_returns:]),
        get=get,
        exceptions=SimpleNamespace(RayError=RayError),
    )
    monkeypatch.setitem(sys.modules, "ray", module)
    yield module
    end_worker()


def test_values_and_files_travel_back(tmp_path, ray):
    answers = {answer.name: answer for answer in run_ray(tasks(tmp_path, "fine", "crash", "fine"), 60.0)}
    assert {name: (answer.kind, answer.value) for name, answer in answers.items()} == {
        "fine-0": ("done", 0), "crash-1": ("died", None), "fine-2": ("done", 20),
    }  # fmt: skip
    assert answers["fine-2"].folder == tmp_path / "fine-2"
    assert sorted(path.name for path in (tmp_path / "fine-2").iterdir()) == ["pid", "sumo.log"]
    assert answers["crash-1"].message.startswith("its process died without an answer (SIGSEGV); last lines of its log:")
    assert not list((tmp_path / "crash-1").iterdir())


def test_a_task_that_ray_loses_is_an_answer(tmp_path, ray):
    def lost(_: int) -> None:
        raise RayError("the node died\nmore")

    ray.get = lost
    (answer,) = run_ray(tasks(tmp_path, "fine"), 60.0)
    assert (answer.kind, answer.message) == ("died", "Ray lost the task: the node died")


def test_without_ray_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"install gri-cosim\[cluster\]"):
        next(run_ray(deque(), 60.0))
