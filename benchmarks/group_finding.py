"""Cost of finding groups against the number of vehicles, by lane and position and over all pairs of vehicles.

    python benchmarks/group_finding.py [--rounds 5]

The traffic is made by hand: four to eight lanes, 20 to 30 m apart in each, for 25 snapshots. The two ways to find the
next vehicles ahead take turns. The fitted exponents say how the cost grows: 1 is linear, 2 is quadratic. Times are CPU
times; medians of the rounds.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np

from cosim.spec.scenario import CarFollowing
from cosim.world.group_search import search_groups
from cosim.world.groups import everybody_ahead, next_ahead
from cosim.world.snapshot import Snapshot

COUNTS = (300, 1190, 3808, 12923)
ALL_PAIRS = 4000  # vehicles, up to which all pairs are looked at; more take minutes
RULE = CarFollowing(min_gap=2, max_gap=45, max_time_gap=2.5, min_speed=1)


def traffic(count: int, time_: float, rng: np.random.Generator) -> Snapshot:
    """Columns of vehicles that all drive at 10 m/s."""
    lanes = 4 if count < 1000 else 8
    lane = np.arange(count) % lanes
    s, d = np.arange(count) // lanes * 25.0 + lane + 10.0 * time_, 3.5 * lane + 0.1 * np.sin(np.arange(count))
    order, n = rng.permutation(count), np.ones(count)
    ids, names = tuple(f"v.{k}" for k in order), tuple(f"e_{k}" for k in lane[order])
    xy = np.stack([s, d], 1)[order]
    return Snapshot(time_, ids, xy, 0 * n, 10 * n, 0 * n, s[order], d[order], 5 * n, 1.8 * n, names)


def cpu(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    rounds = range(parser.parse_args().rounds)
    sorted_, searches = [], []
    for count in COUNTS:
        history = [traffic(count, 0.2 * k, np.random.default_rng(1)) for k in range(25)]
        now, one, both, whole = history[-1], [], [], []
        for _ in rounds:
            one.append(cpu(lambda: everybody_ahead(now)))  # noqa: B023
            if count <= ALL_PAIRS:
                both.append(cpu(lambda: next_ahead(now, np.arange(count))))  # noqa: B023
            zone = (0.0, float(now.s.max()))
            whole.append(cpu(lambda: search_groups(history, RULE, zone=zone, barred={}, limit=100)))  # noqa: B023
        sorted_.append(statistics.median(one))
        searches.append(statistics.median(whole))
        pairs = f"{1e3 * statistics.median(both):8.1f} ms" if both else "       –   "
        print(
            f"{count:6d} vehicles: ahead, by lane and position {1e3 * sorted_[-1]:6.2f} ms, over all pairs {pairs};"
            f" search in 25 snapshots {searches[-1]:.3f} s",
            flush=True,
        )
    for name, costs in (("ahead", sorted_), ("search", searches)):
        exponent = np.polyfit(np.log(COUNTS), np.log(costs), 1)[0]
        print(f"{name}: cost grows with the {exponent:.2f}th power of the number of vehicles")


if __name__ == "__main__":
    main()
