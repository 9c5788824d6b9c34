"""One session of pytest per module, in which all its mutants are tried.

The session runs in a copy of the calling process. It imports the module and its tests as `pytest` does, with all checks
of types and shapes, but runs no test: copies of it do, one for each mutant. So a mutant costs what its tests take.
"""

import ast
import importlib
import json
import os
import random
import signal
import sys
import tempfile
import time
import traceback
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import pytest

from tests.mutation.equivalent import EQUIVALENT
from tests.mutation.mutants import Mutant, mutants
from tests.mutation.which_tests import Found, Watch

OPTIONS = ("-q", "-n", "0", "-p", "no:cacheprovider")
SLOWER = 10.0  # how much longer than the tests of the right code a mutant may take
LEAST = 30.0  # [s] that it may take in any case
LONGEST = 1200.0  # [s] that the tests of the right code may take

Outcome = tuple[str, str, str]
"""Key, description, and what happened: "passed", "failed", "hung" or "equivalent"."""


@dataclass(frozen=True)
class Chosen:
    """Which mutants of each module are tried: `per_module` of them, drawn with `seed`; 0: all.

    `sixth` is the seed of one sixth of all mutants, which stays the same when code is added; only these are tried, or
    with `without` only the others.
    """

    seed: int
    per_module: int
    sixth: int | None = None
    without: bool = False
    control: bool = False

    def of(self, keys: Sequence[str]) -> list[int]:
        """The indices of these mutants."""
        found = [
            k
            for k, key in enumerate(keys)
            if self.sixth is None or (zlib.crc32(f"{self.sixth} {key}".encode()) % 6 == 0) != self.without
        ]
        module = keys[0].partition(":")[0] if keys else ""
        number = min(self.per_module or len(found), len(found))
        return random.Random(f"{module} {self.seed}").sample(found, number)


def search(
    module: str, tests: Sequence[str], chosen: Chosen, known: Mapping[str, str]
) -> Iterator[tuple[int, list[Outcome]]]:
    """Try the mutants of a module; yields numbers of mutants found (to be added up) and outcomes, as they come.

    Outcomes in `known`, by key, are taken from there. Ends the program if a test fails without any change.
    """
    read, write = os.pipe()
    pid = os.fork()
    if not pid:
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        os.close(read)
        with os.fdopen(write, "w", buffering=1) as pipe, tempfile.TemporaryDirectory() as folder:

            def tell(value: dict[str, Any]) -> None:
                print(json.dumps(value), file=pipe)

            try:
                plugin = Search(module, chosen, known, tell)
                code = pytest.main([*OPTIONS, f"--basetemp={folder}/tests", *tests], [plugin])
                if not plugin.ended:
                    tell({"error": f"the tests of {module} cannot be collected: {code}"})
            except BaseException:
                tell({"error": traceback.format_exc()})
        os._exit(0)
    os.close(write)
    with os.fdopen(read) as pipe:
        for line in pipe:
            value = json.loads(line)
            if "error" in value:
                sys.exit(value["error"])
            yield value["number"], [tuple(outcome) for outcome in value["outcomes"]]
    os.waitpid(pid, 0)


class Search:
    """A plugin of pytest that tries mutants instead of running the tests once."""

    def __init__(
        self, module: str, chosen: Chosen, known: Mapping[str, str], tell: Callable[[dict[str, Any]], None]
    ) -> None:
        self._name, self._chosen, self._known, self._tell = module, chosen, known, tell
        self.ended = False

    def pytest_sessionstart(self) -> None:
        """Random examples are the same ones for each mutant, and are not made simpler."""
        from hypothesis import Phase, settings  # pytest wants to import it itself

        phases = (Phase.explicit, Phase.generate)
        settings.register_profile("mutants", database=None, deadline=None, derandomize=True, phases=phases)
        settings.load_profile("mutants")

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        module = importlib.import_module(self._name)
        known, kept = functions(module)
        source = Path(str(module.__file__)).read_text(encoding="utf-8")
        every = [mutant for mutant in mutants(self._name, source) if mutant.function in known]
        try:
            found = tests_of(session, known, kept)
        except RuntimeError as error:
            self._tell({"error": f"the tests of {self._name} fail without any change: {error}"})
            self.ended = True
            return True
        self._tell({"number": len(every), "outcomes": []})
        if self._chosen.control:
            codes = codes_of(ast.parse(source), str(module.__file__))
            tasks = [(name, name, name, codes[name]) for name in known if name in codes]
        else:
            keys = keys_of(every)
            tasks = [(keys[k], str(every[k]), every[k].function, every[k]) for k in self._chosen.of(keys)]
        for key, text, name, change in tasks:
            if key in EQUIVALENT:
                outcome = "equivalent"
            elif key in self._known:
                outcome = self._known[key]
            else:
                code = codes_of(change.tree, str(module.__file__))[name] if isinstance(change, Mutant) else change
                outcome = self._try(session, known[name], code, found.get(name, {}))
            self._tell({"number": 0, "outcomes": [(key, text, outcome)]})
        self.ended = True
        return True

    def _try(self, session: pytest.Session, function: FunctionType, code: CodeType, tests: Mapping[str, float]) -> str:
        if not tests:
            return "passed"

        def run() -> bool:
            function.__code__ = code
            items = {item.nodeid: item for item in session.items}
            return run_items(session, [items[test] for test in sorted(tests, key=lambda test: tests[test])])

        return in_a_copy(run, max(LEAST, SLOWER * sum(tests.values())))


def functions(module: ModuleType) -> tuple[dict[str, FunctionType], set[str]]:
    """The functions and methods of a module by qualified name, without what wraps them; and which keep their results.

    Those are run in the first test that needs them, so that any test may notice a change.
    """
    found, kept = dict[str, FunctionType](), set[str]()

    def add(value: Any) -> None:
        keeps = isinstance(value, cached_property)
        value = value.fget if isinstance(value, property) else getattr(value, "__func__", getattr(value, "func", value))
        while hasattr(value, "__wrapped__"):
            keeps |= hasattr(value, "cache_info")
            value = value.__wrapped__
        if isinstance(value, FunctionType) and value.__module__ == module.__name__:
            found[value.__qualname__] = value
            kept.update([value.__qualname__] if keeps else [])

    for value in list(vars(module).values()):
        if isinstance(value, type) and value.__module__ == module.__name__:
            for member in list(vars(value).values()):
                add(member)
        else:
            add(value)
    return found, kept


def codes_of(tree: ast.Module, file: str) -> dict[str, CodeType]:
    """The code of every function and class in a module by qualified name."""
    found, waiting = dict[str, CodeType](), [compile(tree, file, "exec", dont_inherit=True)]
    while waiting:
        code = waiting.pop()
        found[code.co_qualname] = code
        waiting += [part for part in code.co_consts if isinstance(part, CodeType)]
    return found


def keys_of(every: Sequence[Mutant]) -> list[str]:
    """What names each mutant also when lines move; the second of the same name has a number."""
    counts, keys = Counter[str](), list[str]()
    for mutant in every:
        counts[mutant.name] += 1
        keys.append(f"{mutant.name} #{counts[mutant.name]}")
    return keys


def tests_of(session: pytest.Session, known: Mapping[str, FunctionType], kept: set[str]) -> Found:
    """Per function the tests that run it, or all if its results are kept; RuntimeError if one of them fails."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "found.json"

        def run() -> bool:
            watch = Watch({name: function.__code__ for name, function in known.items()})
            session.config.pluginmanager.register(watch)
            passed = run_items(session, session.items)
            file.write_text(json.dumps([watch.last, watch.found(kept)]))
            return passed

        outcome = in_a_copy(run, LONGEST)
        last, found = json.loads(file.read_text()) if file.exists() else ("", {})
    if outcome != "passed":
        raise RuntimeError(f"{last} {outcome}")
    return found


def run_items(session: pytest.Session, items: Sequence[pytest.Item]) -> bool:
    """Run these tests in this order until the first failure: whether there is none."""
    for item, following in zip(items, [*items[1:], None], strict=True):
        session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if session.testsfailed:
            return False
    return True


def in_a_copy(run: Callable[[], bool], limit: float) -> str:
    """Run something in a copy of this process: "passed", "failed" or "hung"; `limit` is in seconds."""
    began, pid = time.monotonic(), os.fork()
    if not pid:
        code = 1
        try:
            os.setsid()
            code = 0 if run() else 1
        finally:
            os._exit(code)
    outcome, pause = "hung", 0.001
    while time.monotonic() - began < limit:
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            outcome = "failed" if os.waitstatus_to_exitcode(status) else "passed"
            break
        time.sleep(pause := min(1.2 * pause, 0.05))
    with suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)  # and what it started
    if outcome == "hung":
        os.waitpid(pid, 0)
    return outcome
