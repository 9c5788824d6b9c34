"""Mutation testing: how many small mistakes in the modules of `targets.py` their tests notice.

    python -m tests.mutation [--per-module 10] [--module cosim.batch.execute] [--seed 1] [--log tried.jsonl]

Each module gets one session of pytest, which collects its tests once (`session.py`). Every mutant then gets a copy of
that process, in which the code of one function is replaced and those tests that run the function are run until the
first failure, the shortest first. Prints the survivors, and the share that was noticed with its 95 % interval. A mutant
that changes nothing that can be seen counts as a survivor, unless `equivalent.py` names it and says why nobody can see
it; those do not count. With a log, mutants that it has are not tried again, so that a long search can be stopped and
continued; survivors are, with `--again`. `--without-sixth 7` leaves out every sixth mutant, and `--sixth 7` tries only
those: who writes tests for what survives there has a sample that was never looked at. `--control` replaces the code of
each function by the same code instead; no test may fail then.
"""

import argparse
import json
from collections import Counter
from pathlib import Path

import numpy as np

from tests.mutation.session import Chosen, search
from tests.mutation.targets import TARGETS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--per-module", type=int, default=10, help="mutants to try, drawn from each module; 0: all")
    parser.add_argument("--log", type=Path, help="a file of outcomes to continue")
    parser.add_argument("--module", choices=list(TARGETS), action="append", help="only this module; repeatable")
    parser.add_argument("--seed", type=int, default=1)
    sixth = parser.add_mutually_exclusive_group()
    sixth.add_argument("--sixth", type=int, metavar="SEED", help="only one sixth of all mutants, chosen by this seed")
    sixth.add_argument("--without-sixth", type=int, metavar="SEED", help="all but this sixth")
    parser.add_argument("--again", action="store_true", help="try those once more that survived according to the log")
    parser.add_argument("--control", action="store_true", help="change nothing: every function should survive")
    given = parser.parse_args()
    tried: dict[str, str] = {}
    if given.log and given.log.is_file():
        tried = dict(map(json.loads, given.log.read_text().splitlines()))
    known = {key: outcome for key, outcome in tried.items() if not (given.again and outcome == "passed")}
    without = given.without_sixth is not None
    chosen = Chosen(
        given.seed, given.per_module, given.without_sixth if without else given.sixth, without, given.control
    )
    every, by_module = 0, dict[str, Counter[str]]()
    for module in given.module or TARGETS:
        counts = by_module[module] = Counter[str]()
        for number, outcomes in search(module, TARGETS[module], chosen, known):
            every += number
            for key, text, outcome in outcomes:
                counts[outcome] += 1
                if given.log and tried.get(key) != outcome:
                    with given.log.open("a") as log:
                        log.write(json.dumps([key, outcome]) + "\n")
                if outcome == "passed" and not given.control:
                    print(f"survived: {text}", flush=True)
                if outcome != "passed" and given.control:
                    print(f"{outcome} without any change: {text}", flush=True)
        print(f"{module}: {of(counts)}", flush=True)
    total = sum(by_module.values(), Counter())
    print(f"{every} mutants of {len(by_module)} modules: {of(total)}, {interval(total)}")


def of(counts: Counter[str]) -> str:
    """How many were noticed, in words."""
    noticed, total = counts["failed"] + counts["hung"], counts.total() - counts["equivalent"]
    hung = f" ({counts['hung']} by their time)" if counts["hung"] else ""
    same = f", besides {counts['equivalent']} that change nothing that can be seen" if counts["equivalent"] else ""
    return f"noticed {noticed}{hung} of {total}{same}: {100 * noticed / max(total, 1):.1f} %"


def interval(counts: Counter[str]) -> str:
    """The 95 % interval of the share that was noticed, in words."""
    from cosim.measures.statistics import share  # the sessions import it with checks of its types, so not before them

    noticed, total = counts["failed"] + counts["hung"], counts.total() - counts["equivalent"]
    value = share(np.arange(total) < noticed, np.arange(total))
    return f"95 % interval {100 * value.low:.1f} to {100 * value.high:.1f} %"


if __name__ == "__main__":
    main()
