"""Mutation testing: how many small mistakes in the modules of `targets.py` their tests notice.

    python -m tests.mutation [--per-module 10] [--module cosim.batch.execute] [--seed 1] [--log tried.jsonl]

Modules are imported once; every mutant then gets a copy of this process, in which the code of one function is replaced
and those tests of its module that run the function are run until the first failure, the shortest first. Prints the
survivors, and the share that was noticed with its 95 % interval. A mutant that changes nothing that can be seen counts
as a survivor, unless `equivalent.py` names it and says why nobody can see it; those do not count. With a log, mutants
that it has are not tried again, so that a long search can be stopped and continued; survivors are, with `--again`.
"""

import argparse
import importlib
import json
import os
import random
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import zip_longest
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
import pytest

from cosim.measures.statistics import share
from tests.mutation.equivalent import EQUIVALENT
from tests.mutation.mutants import Mutant, mutants
from tests.mutation.targets import TARGETS
from tests.mutation.which_tests import Found, Only, Watch

OPTIONS = ("-x", "-q", "-p", "no:cacheprovider", "-o", "addopts=--import-mode=importlib")
OPTIONS += ("-m", "not slow", "-o", "filterwarnings=default")  # modules are imported before the tests, which warns
SLOWER = 10.0  # how much longer than the tests of the right code a mutant may take
LEAST = 60.0  # [s] that it may take in any case
LONGEST = 1200.0  # [s] that the tests of the right code may take


def functions(module: ModuleType) -> dict[str, FunctionType]:
    """The functions and methods of a module by qualified name, without what wraps them."""
    found: dict[str, FunctionType] = {}

    def add(value: Any) -> None:
        value = value.fget if isinstance(value, property) else getattr(value, "__func__", getattr(value, "func", value))
        while hasattr(value, "__wrapped__"):
            value = value.__wrapped__
        if isinstance(value, FunctionType) and value.__module__ == module.__name__:
            found[value.__qualname__] = value

    for value in list(vars(module).values()):
        if isinstance(value, type) and value.__module__ == module.__name__:
            for member in list(vars(value).values()):
                add(member)
        else:
            add(value)
    return found


def code_of(mutant: Mutant, file: str) -> CodeType | None:
    """The code of the mutant's function."""
    waiting = [compile(mutant.tree, file, "exec", dont_inherit=True)]
    while waiting:
        code = waiting.pop()
        if code.co_qualname == mutant.function:
            return code
        waiting += [part for part in code.co_consts if isinstance(part, CodeType)]
    return None


def tests_of(module: str, known: dict[str, FunctionType]) -> Found:
    """Per function of a module the tests that run it. Ends the program if one of them fails without any change."""
    read, write = os.pipe()
    watch = Watch({name: function.__code__ for name, function in known.items()})

    def tell() -> None:
        with os.fdopen(write, "w") as pipe:
            json.dump(watch.found(), pipe)

    if run_tests(TARGETS[module], lambda: None, LONGEST, watch, tell) != "passed":
        sys.exit(f"the tests of {module} fail without any change")
    os.close(write)
    with os.fdopen(read) as pipe:
        return json.load(pipe)


def run_tests(
    tests: Sequence[str],
    prepare: Callable[[], None],
    limit: float,
    plugin: object,
    afterwards: Callable[[], None] = lambda: None,
) -> str:
    """Run tests in a copy of this process: "passed", "failed" or "hung"; `limit` is in seconds."""
    began, pid = time.monotonic(), os.fork()
    if not pid:
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        os.setsid()
        code = 1
        try:
            prepare()
            code = pytest.main([*OPTIONS, *tests], [plugin])
            afterwards()
        finally:
            os._exit(int(code))
    while time.monotonic() - began < limit:
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            return "failed" if os.waitstatus_to_exitcode(status) else "passed"
        time.sleep(0.05)
    os.killpg(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return "hung"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--per-module", type=int, default=10, help="mutants to try, drawn from each module; 0: all")
    parser.add_argument("--log", type=Path, help="a file of outcomes to continue")
    parser.add_argument("--module", choices=list(TARGETS), action="append", help="only this module; repeatable")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--again", action="store_true", help="try those once more that survived according to the log")
    given = parser.parse_args()
    chosen = given.module or list(TARGETS)
    modules = {name: importlib.import_module(name) for name in chosen}
    known = {name: functions(module) for name, module in modules.items()}
    every, drawn = 0, list[list[Mutant]]()
    for name, module in modules.items():
        source = Path(str(module.__file__)).read_text(encoding="utf-8")
        found = [mutant for mutant in mutants(name, source) if mutant.function in known[name]]
        every += len(found)
        number = min(given.per_module or len(found), len(found))
        drawn.append(random.Random(f"{name} {given.seed}").sample(found, number))
    # One of each module after the other: a search that is stopped early has tried as many of each.
    sample = [mutant for turn in zip_longest(*drawn) for mutant in turn if mutant]
    print(f"{every} mutants of {len(chosen)} modules, {len(sample)} of them drawn", flush=True)
    tried = {}
    if given.log and given.log.is_file():
        tried = dict(map(json.loads, given.log.read_text().splitlines()))
    counts, found = Counter[str](), dict[str, Found]()
    for mutant in sample:
        key = f"{mutant} at {mutant.place}"
        if mutant.name in EQUIVALENT:
            counts["equivalent"] += 1
            continue
        if key in tried and not (given.again and tried[key] == "passed"):
            counts[tried[key]] += 1
            continue
        if mutant.module not in found:
            found[mutant.module] = tests_of(mutant.module, known[mutant.module])
        function, code = known[mutant.module][mutant.function], code_of(mutant, str(modules[mutant.module].__file__))
        if code is None or len(code.co_freevars) != len(function.__code__.co_freevars):
            continue

        def change(function: FunctionType = function, code: CodeType = code) -> None:
            function.__code__ = code

        tests = found[mutant.module].get(mutant.function, {})
        shortest_first = sorted(tests, key=lambda test: tests[test])
        files = dict.fromkeys(test.partition("::")[0] for test in shortest_first)
        limit = max(LEAST, SLOWER * sum(tests.values()))
        outcome = run_tests([*files], change, limit, Only(shortest_first)) if tests else "passed"
        counts[outcome] += 1
        if given.log:
            with given.log.open("a") as log:
                log.write(json.dumps([key, outcome]) + "\n")
        if outcome == "passed":
            print(f"survived: {mutant}", flush=True)
    noticed, total = counts["failed"] + counts["hung"], counts.total() - counts["equivalent"]
    value = share(np.arange(total) < noticed, np.arange(total))
    print(
        f"noticed {noticed} of {total}: {100 * value.value:.0f} % ({100 * value.low:.0f} to {100 * value.high:.0f} %);"
        f" {counts['equivalent']} more change nothing that can be seen"
    )


if __name__ == "__main__":
    main()
