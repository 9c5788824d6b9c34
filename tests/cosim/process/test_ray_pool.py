"""Tasks on a stand-in for Ray, which calls functions at once and in this process."""

import sys
from collections import deque
from functools import partial
from types import SimpleNamespace

import pytest

from cosim.process.ray_pool import run_ray
from cosim.process.remote_task import AwayWorker, end_worker
from cosim.process.task import TaskResult
from cosim.process.task_pool import key_of
from gri.errors import InputError
from tests.cosim.process.conftest import tasks
from tests.cosim.process.test_prepared_process import prepared


class RayError(Exception):
    pass


@pytest.fixture
def ray(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    results: dict[int, object] = {}

    made: list[object] = []

    def call(function, *arguments) -> int:
        results[len(results)] = function(*arguments)
        return len(results) - 1

    def actor(kind) -> SimpleNamespace:
        made.append(kind())
        return SimpleNamespace(perform=SimpleNamespace(remote=partial(call, made[-1].perform)))

    def get(reference: int) -> object:
        return results[reference]

    module = SimpleNamespace(
        init=lambda **_: None,
        shutdown=lambda: None,
        cluster_resources=lambda: {"CPU": 1},
        actors=made,
        remote=lambda **_: lambda kind: SimpleNamespace(remote=partial(actor, kind)),
        wait=lambda waiting, num_returns, timeout: (sorted(waiting)[:num_returns], sorted(waiting)[num_returns:]),
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


def test_tasks_with_the_same_preparation_go_to_the_process_that_has_it(tmp_path, ray, monkeypatch):
    """In three processes: each takes its own kind as long as there are tasks of it, then what is left."""
    taken: dict[object, list[str]] = {}

    def noted(self, task, limit, folder):
        taken.setdefault(self, []).append(key_of(task))
        return TaskResult(task.name, task.folder, "done"), {}

    monkeypatch.setattr(AwayWorker, "perform", noted)
    queue = prepared(tmp_path, *(("fine", what) for what in ("a", "b", "c", "d") * 3))
    assert len(list(run_ray(queue, 60.0, workers=3))) == 12
    assert len(ray.actors) == 3
    assert sorted(taken.values()) == [["a", "a", "a", "d"], ["b", "b", "b", "d"], ["c", "c", "c", "d"]]


def test_a_preparation_is_entered_once_in_a_process(tmp_path, ray):
    values = [answer.value for answer in run_ray(prepared(tmp_path, *[("fine", "one")] * 3), 60.0)]
    assert len({process for process, _ in values}) == 1


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
