"""Mutation testing: how many small mistakes in the modules of `targets.py` their tests notice.

    python -m tests.mutation [--per-module 10] [--module cosim.batch.execute] [--seed 1] [--log tried.jsonl]

Modules and tests are imported once; every mutant then gets a copy of this process, in which the code of one function is
replaced and the tests of its module run until the first failure. Prints the survivors, and the share that was noticed
with its 95 % interval. A mutant that changes nothing that can be seen counts as a survivor. With a log, mutants that it
has are not tried again, so that a long search can be stopped and continued.
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
from collections.abc import Callable
from itertools import zip_longest
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
import pytest

from cosim.measures.statistics import share
from tests.mutation.mutants import Mutant, mutants
from tests.mutation.targets import TARGETS

OPTIONS = ("-x", "-q", "-p", "no:cacheprovider", "-o", "addopts=--import-mode=importlib")
OPTIONS += ("-m", "not slow", "-o", "filterwarnings=default")  # modules are imported before the tests, which warns
SLOWER = 10.0  # how much longer than the tests of the right code a mutant may take
LEAST = 60.0  # [s] that it may take in any case


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


def run_tests(tests: tuple[str, ...], prepare: Callable[[], None], limit: float) -> tuple[str, float]:
    """Run tests in a copy of this process: "passed", "failed" or "hung", and how long it took [s]."""
    began, pid = time.monotonic(), os.fork()
    if not pid:
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        os.setsid()
        code = 1
        try:
            prepare()
            code = pytest.main([*OPTIONS, *tests])
        finally:
            os._exit(int(code))
    while time.monotonic() - began < limit:
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            return ("failed" if os.waitstatus_to_exitcode(status) else "passed"), time.monotonic() - began
        time.sleep(0.05)
    os.killpg(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return "hung", time.monotonic() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--per-module", type=int, default=10, help="mutants to try, drawn from each module; 0: all")
    parser.add_argument("--log", type=Path, help="a file of outcomes to continue")
    parser.add_argument("--module", choices=list(TARGETS), action="append", help="only this module; repeatable")
    parser.add_argument("--seed", type=int, default=1)
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
    counts, limits = Counter[str](), dict[str, float]()
    for mutant in sample:
        key = f"{mutant} at {mutant.place}"
        if key in tried:
            counts[tried[key]] += 1
            continue
        if mutant.module not in limits:
            outcome, seconds = run_tests(TARGETS[mutant.module], lambda: None, 1200.0)
            if outcome != "passed":
                sys.exit(f"the tests of {mutant.module} {outcome} without any change")
            limits[mutant.module] = max(LEAST, SLOWER * seconds)
        function, code = known[mutant.module][mutant.function], code_of(mutant, str(modules[mutant.module].__file__))
        if code is None or len(code.co_freevars) != len(function.__code__.co_freevars):
            continue

        def change(function: FunctionType = function, code: CodeType = code) -> None:
            function.__code__ = code

        outcome, _ = run_tests(TARGETS[mutant.module], change, limits[mutant.module])
        counts[outcome] += 1
        if given.log:
            with given.log.open("a") as log:
                log.write(json.dumps([key, outcome]) + "\n")
        if outcome == "passed":
            print(f"survived: {mutant}", flush=True)
    noticed, total = counts["failed"] + counts["hung"], counts.total()
    found = share(np.arange(total) < noticed, np.arange(total))
    print(
        f"noticed {noticed} of {total}: {100 * found.value:.0f} % ({100 * found.low:.0f} to {100 * found.high:.0f} %)"
    )


if __name__ == "__main__":
    main()
