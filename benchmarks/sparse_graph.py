"""How long inference on candidate pairs takes as the vehicles grow in number, and how accurate it is on chains.

    python benchmarks/sparse_graph.py

Speed: vehicles of five lanes at 40 m of spacing; candidate pairs by `gri.core.candidate_pairs`, then the graph by the
pair encoder of `us101_car_following`, in one thread. It states the CPU time and the exponent of a power law between 100
and 5,000 vehicles (1 is linear). Pairs of different lanes have no edge in car following, so that those of the own lane
are inferred.

Accuracy: chains of 2, 4 and 8 vehicles that the policy of `us101_car_following_supervised` drives under a known graph:
a pair of neighbours follows with probability 1 (whole) or .6 (broken). Beside it, what constants get.
"""

import time

import numpy as np
import torch

import gri
from gri.core.candidate_pairs import candidate_pairs
from gri.core.edges import pairs
from gri.data.ranges.car_following import US101
from gri.data.ranges.leader import leader_states, uniform
from gri.networks.fast_pair_encoder import explain_pairs
from gri.networks.pair_encoder import PairEncoder
from gri.networks.rollout import rollout

SIZES = (100, 200, 500, 1000, 2000, 5000)
STEPS, LANES, SPACING = 25, 5, 40.0
REPEATS = 9


def traffic(count: int, seed: int) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
    """Positions, speeds [V, T] and lanes of vehicles at random."""
    rng = np.random.default_rng(seed)
    lane = rng.integers(0, LANES, count)
    v = 15 + 0.3 * rng.standard_normal((count, STEPS)).cumsum(1)
    x = rng.uniform(0, SPACING * count / LANES, count)[:, None] + 0.2 * v.cumsum(1)
    return torch.from_numpy(x), torch.from_numpy(v), lane


def seconds(count: int, encoder: PairEncoder) -> tuple[float, int]:
    """Least CPU time [s] of candidates and inference, and the number of candidate pairs that are judged."""
    x, v, lane = traffic(count, count)
    lanes, length = lane[:, None].repeat(2, 1), np.full(count, 5.0)
    best, judged = np.inf, 0
    for _ in range(REPEATS):
        began = time.process_time()
        chosen = candidate_pairs(x[:, -1].numpy(), lanes, length, adjacent=False)
        explain_pairs(encoder, x, v, torch.from_numpy(chosen))
        best, judged = min(best, time.process_time() - began), len(chosen)
    return best, judged


def chains(n: int, share: float, count: int, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """States [S, N, T, 3] of chains without contact, and their true types over all ordered pairs."""
    generator, starts, constants = torch.Generator().manual_seed(seed), US101.starts, US101.reward.constants
    speed = uniform(generator, *starts.speed, count, 1)
    for _ in range(n - 1):
        speed = torch.cat([(speed[:, :1] + uniform(generator, -4, 4, count, 1)).clamp(0, 29), speed], 1)
    settled = torch.rand(count, 1, generator=generator) < starts.settled
    wished = (constants.standstill + constants.time_headway * speed[:, :-1]) * uniform(
        generator, 1 - starts.spread, 1 + starts.spread, count, n - 1
    )
    headway = torch.where(settled, wished, uniform(generator, *starts.headway, count, n - 1)).clamp(*starts.headway)
    position = torch.cat([-headway.flip(1).cumsum(1).flip(1), torch.zeros(count, 1)], 1)
    start = torch.stack([position, speed, torch.zeros_like(position)], -1)
    leader = leader_states(US101.leader, start[:, -1], 45, US101.dt, generator)
    types = torch.zeros(count, n * (n - 1), dtype=torch.long)
    for j in range(n - 1):
        types[:, pairs(n).index((j + 1, j))] = (torch.rand(count, generator=generator) < share).long()
    driver = gri.load("us101_car_following_supervised")
    with torch.no_grad():
        state = rollout(driver, start, torch.nn.functional.one_hot(types, 2).float(), leader).state
    apart = (state[:, 1:, :, 0] - state[:, :-1, :, 0] > 5.3).all(-1).all(-1)
    return state[apart][:400, :, :STEPS], types[apart][:400]


def accuracy(n: int, share: float) -> str:
    """Shares of right pairs in percent: all ordered pairs, pairs of neighbours, and constants."""
    state, truth = chains(n, share, 600 if n < 8 else 3000, n)
    candidates = tuple((i, j) for i in range(n) for j in (i - 1, i + 1) if 0 <= j < n)
    found = gri.load("us101_car_following").infer(state, candidates).map
    types = torch.zeros_like(truth)
    types[:, [pairs(n).index(pair) for pair in candidates]] = found
    ahead = [pairs(n).index((j + 1, j)) for j in range(n - 1)]
    row = torch.zeros_like(truth[0])
    row[ahead] = 1
    figures = {
        "all pairs": types == truth,
        "next ahead": (types == truth)[:, ahead],
        "always the next ahead": truth == row,
        "no edge": truth == 0,
    }
    shown = ", ".join(f"{name} {100 * float(right.double().mean()):.1f}" for name, right in figures.items())
    return f"{len(state)} chains of {n}: {shown} %"


def main() -> None:
    torch.set_num_threads(1)
    encoder = gri.load("us101_car_following").encoder
    assert isinstance(encoder, PairEncoder)
    with torch.inference_mode():
        taken = {count: seconds(count, encoder) for count in SIZES}
    for count, (spent, judged) in taken.items():
        print(f"{count} vehicles, {judged} pairs: {1e3 * spent:.1f} ms, {1e6 * spent / count:.0f} µs a vehicle")
    exponent = np.polyfit(np.log(SIZES), np.log([spent for spent, _ in taken.values()]), 1)[0]
    print(f"time grows with vehicles to the power of {exponent:.2f}")
    for share, name in ((1.0, "whole"), (0.6, "broken")):
        for n in (2, 4, 8):
            print(f"{name}: {accuracy(n, share)}")


if __name__ == "__main__":
    main()
