"""The pool of workers of a stress test."""

import multiprocessing
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import pytest

from cosim.stress.stress_test import _finish
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
