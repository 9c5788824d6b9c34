"""Which tests of a module run which of its functions, and how long each of them takes.

A plugin of pytest. In a first run `Watch` notes what the tests run; later ones run only the tests of one function, the
shortest first, so that most mutants are noticed within a second.
"""

import sys
import time
from collections import defaultdict
from collections.abc import Generator, Mapping, Set
from types import CodeType, FrameType
from typing import Any

import pytest

Found = dict[str, dict[str, float]]
"""Per function the tests that run it, and how long each of them takes [s]."""


class Watch:
    """Notes which of some functions run in each test. What a fixture runs counts for all tests of its file."""

    def __init__(self, functions: Mapping[str, CodeType]) -> None:
        self._names = {code: name for name, code in functions.items()}
        self._run: dict[str, set[str]] = defaultdict(set)  # by test, or by file for fixtures
        self._seconds: dict[str, float] = {}
        self.last = ""

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Generator[None, Any, Any]:
        return (yield from self._watched(item.nodeid.partition("::")[0], item.nodeid))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, Any, Any]:
        return (yield from self._watched(item.nodeid, item.nodeid))

    def _watched(self, owner: str, test: str) -> Generator[None, Any, Any]:
        def watch(frame: FrameType, event: str, argument: object) -> None:
            if event == "call" and (name := self._names.get(frame.f_code)):
                self._run[owner].add(name)

        self.last = test
        began, before = time.perf_counter(), sys.getprofile()
        sys.setprofile(watch)
        try:
            return (yield)
        finally:
            sys.setprofile(before)
            self._seconds[test] = self._seconds.get(test, 0.0) + time.perf_counter() - began

    def found(self, in_all: Set[str] = frozenset()) -> Found:
        """The tests of each function that any of them runs; of some functions all tests count."""
        found: Found = defaultdict(dict)
        for test, seconds in self._seconds.items():
            for name in self._run[test] | self._run[test.partition("::")[0]]:
                found[name][test] = seconds
        for name in in_all & found.keys():
            found[name] = dict(self._seconds)
        return dict(found)
