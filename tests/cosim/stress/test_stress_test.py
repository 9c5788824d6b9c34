"""The pool of workers of a stress test."""

import multiprocessing
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import pandas as pd
import pytest

from cosim.spec.loading import load_scenario
from cosim.spec.scenario import Idm
from cosim.stress.plan import Cell, Chunk
from cosim.stress.stress_test import _finish, fewer_starts
from gri.errors import InputError


def test_a_failure_ends_the_workers_of_the_others_even_one_that_is_about_to_start():
    failed, ended = Event(), []

    def fail() -> None:
        failed.set()
        raise InputError("no starts")

    def begin_late() -> None:
        failed.wait()
        time.sleep(0.5)
        process = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(600,))
        process.start()
        process.join()
        ended.append(process.exitcode)

    with ThreadPoolExecutor(2) as pool, pytest.raises(InputError, match="no starts"):
        _finish([pool.submit(begin_late), pool.submit(fail)])
    assert ended == [-signal.SIGTERM]


def test_cells_with_fewer_starts_than_asked_for_are_named():
    """Two seeds with 3 starts each; under one perturbation the second seed found 1, under another all."""
    scenario, cells = load_scenario("us101_merge"), (Cell(), Cell("leader_braking", 8.0))
    chunks = [Chunk(scenario, {"idm": Idm(), "sumo": Idm()}, (cell,), 3) for cell in cells for _ in range(2)]
    found = {cells[0]: 6, cells[1]: 4}
    rows = pd.DataFrame(
        [
            {"policy": name, "perturbation": cell.perturbation, "intensity": cell.intensity}
            for cell, count in found.items()
            for name in ("idm", "sumo")
            for _ in range(count)
        ]
    ).astype({"intensity": float})
    said = fewer_starts(chunks, rows)
    assert said == "Fewer starts than asked for within the time limit of 2400 s: leader_braking 8: 4 of 6."
    assert fewer_starts(chunks[:2], rows) == ""
