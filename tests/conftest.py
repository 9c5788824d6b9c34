"""Fixtures for all tests, and how tests are spread over the cores."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from tests import shape_checks

FEW = 3  # test files that one process has done before a second one would have imported torch and SUMO
TOGETHER = ("tests/cosim/commands/", "tests/cosim/environments/")  # their tests share fixtures of a session
shape_checks.install()
os.environ.setdefault("COSIM_CORE", "python")  # the reference, whatever is built here; tests/cosim/core compares


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """The first calls of every function are checked in every test."""
    shape_checks.start_over()


@pytest.fixture(autouse=True, scope="session")
def one_thread() -> Iterator[None]:
    """The matrices are small: one thread is faster, and sums come out the same everywhere."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def generator() -> torch.Generator:
    """A source of randomness that starts at the same place in every test."""
    return torch.Generator().manual_seed(20240607)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """A process per core; none besides this one where only a few files are named."""
    named = [Path(argument.partition("::")[0]) for argument in config.args]
    if len(named) <= FEW and all(path.suffix == ".py" for path in named):
        return 0
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Callable[..., None]) -> Any:
    """The tests of a file stay in one process, as they share fixtures; those of some folders do, too."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFixtures(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return next((folder for folder in TOGETHER if nodeid.startswith(folder)), nodeid.partition("::")[0])

    return ByFixtures(config, log)
