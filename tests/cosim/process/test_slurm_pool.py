"""Tasks as jobs, by submitit's executor for this machine."""

import os
import sys
from collections import deque
from pathlib import Path

import pytest

from cosim.process.slurm_pool import JOBS, run_slurm
from gri.errors import InputError
from tests.cosim.process.conftest import tasks


@pytest.fixture
def jobs_find_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs are processes of their own, in this folder and with the modules that this process has."""
    pytest.importorskip("submitit")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *filter(None, sys.path)]))


@pytest.mark.usefixtures("jobs_find_the_work")
@pytest.mark.filterwarnings("ignore")
def test_values_and_files_come_back_from_jobs(tmp_path: Path) -> None:
    queue = tasks(tmp_path, "fine", "crash", "fine")
    answers = {answer.name: answer for answer in run_slurm(queue, 60.0, workers=2, cluster="local")}
    assert {name: (answer.kind, answer.value) for name, answer in answers.items()} == {
        "fine-0": ("done", 0), "crash-1": ("died", None), "fine-2": ("done", 20),
    }  # fmt: skip
    assert sorted(path.name for path in (tmp_path / "fine-2").iterdir()) == ["pid", "sumo.log"]
    assert [*JOBS.glob("*_log.out")], "the logs of the jobs stay"


@pytest.mark.usefixtures("jobs_find_the_work")
@pytest.mark.filterwarnings("ignore")
def test_closing_cancels_the_jobs_under_way(tmp_path: Path) -> None:
    answers = run_slurm(tasks(tmp_path, "fine", "fine", "fine"), 60.0, workers=1, cluster="local")
    assert next(answers).kind == "done"
    answers.close()
    assert not (tmp_path / "fine-2").exists()


def test_what_is_missing_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "submitit", None)
    with pytest.raises(InputError, match=r"install gri-cosim\[slurm\]"):
        next(run_slurm(deque(), 60.0))


def test_without_slurm_the_command_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("submitit")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match="no Slurm here"):
        next(run_slurm(deque(), 60.0))
