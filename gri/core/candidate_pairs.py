"""Which ordered pairs of vehicles can matter to each other at all: a conservative rule of lanes and distances.

A graph over all V(V−1) ordered pairs of a freeway cannot be inferred, and nearly all of its edges are none. This rule
keeps, for every receiver, the senders that a driver can react to:

- own lane: the next vehicle ahead and the next one behind,
- each adjacent lane: the next ahead, every one alongside, and the next behind,

if their bumpers are at most `reach` apart. A vehicle between two lanes counts in both. The number of pairs grows
linearly with the vehicles; the cost is that of sorting them. Needs numpy only.
"""

import numpy as np
from jaxtyping import Float, Int

REACH = 100.0  # [m] between bumpers


def candidate_pairs(
    s: Float[np.ndarray, " V"],
    lanes: Int[np.ndarray, "V 2"],
    length: Float[np.ndarray, " V"],
    reach: float = REACH,
    adjacent: bool = True,
) -> Int[np.ndarray, "E 2"]:
    """The candidate pairs (sender, receiver) in lexicographic order, each once.

    Args:
        s: front bumpers along the road [m].
        lanes: number of the rightmost and of the leftmost lane that a vehicle touches; numbers of neighbours differ by
            1.
        length: of the vehicles [m].
        reach: greatest distance between bumpers along the road [m].
        adjacent: whether vehicles of adjacent lanes are candidates; without them, only those of the own lane.
    """
    count = len(s)
    if not count:
        return np.zeros((0, 2), dtype=np.int64)
    vehicle, lane = _places(lanes)
    order = np.lexsort((s[vehicle], lane))
    vehicle, lane = vehicle[order], lane[order]
    fronts, rears = s[vehicle], s[vehicle] - length[vehicle]
    stride = 2 * (float(np.ptp(s)) + float(length.max()) + 1.0)  # one axis on which lanes lie behind one another
    base = lane * stride - fronts.min()
    # Where vehicles of a lane overlap, the order of their rears is not that of their fronts.
    sorted_rears = np.minimum.accumulate((base + rears)[::-1])[::-1]
    found = []
    for side in (-1, 0, 1) if adjacent else (0,):
        shift = base + side * stride
        begin = np.searchsorted(lane, lane + side, "left")
        end = np.searchsorted(lane, lane + side, "right")
        behind = np.clip(np.searchsorted(base + fronts, shift + rears, "left"), begin, end)
        ahead = np.clip(np.searchsorted(sorted_rears, shift + fronts, "right"), behind, end)
        found.append(_pairs_of_ranges(np.maximum(behind - 1, begin), np.minimum(ahead + 1, end), vehicle))
    senders, receivers = (np.concatenate(ends) for ends in zip(*found, strict=True))
    apart = np.maximum(s[senders] - length[senders] - s[receivers], s[receivers] - length[receivers] - s[senders])
    near = (apart <= reach) & (senders != receivers)
    code = np.unique(senders[near] * count + receivers[near])
    return np.stack([code // count, code % count], 1)


def _places(lanes: Int[np.ndarray, "V 2"]) -> tuple[Int[np.ndarray, " O"], Int[np.ndarray, " O"]]:
    """Every vehicle once for each lane that it touches: rows of vehicles, and lanes."""
    touched = lanes[:, 1] - lanes[:, 0] + 1
    vehicle = np.repeat(np.arange(len(lanes)), touched)
    return vehicle, lanes[vehicle, 0] + _count_up(touched)


def _count_up(sizes: Int[np.ndarray, " R"]) -> Int[np.ndarray, " O"]:
    """0, 1, …, size − 1 for every size, one after the other."""
    return np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)


def _pairs_of_ranges(
    begin: Int[np.ndarray, " O"], end: Int[np.ndarray, " O"], vehicle: Int[np.ndarray, " O"]
) -> tuple[Int[np.ndarray, " E"], Int[np.ndarray, " E"]]:
    """Senders at the places from `begin` to `end` (excluded), and the vehicle that each range belongs to."""
    sizes = np.maximum(end - begin, 0)
    return vehicle[np.repeat(begin, sizes) + _count_up(sizes)], np.repeat(vehicle, sizes)


def lanes_touched(
    d: Float[np.ndarray, " V"], width: Float[np.ndarray, " V"], lane_width: float
) -> Int[np.ndarray, "V 2"]:
    """The rightmost and the leftmost lane that a vehicle of this `width` [m] touches.

    `d` [m] is the lateral position of its centre, to the left, from the centre of lane 0. All lanes are `lane_width`
    [m] wide; a vehicle is never in more lanes than that of its centre and one beside it.
    """
    own = np.floor(d / lane_width + 0.5)
    reaches = 0.5 * np.minimum(width, lane_width) / lane_width
    right = np.floor(d / lane_width - reaches + 0.5 + 1e-9)
    left = np.ceil(d / lane_width + reaches - 0.5 - 1e-9)
    return np.stack([np.minimum(right, own), np.maximum(left, own)], 1).astype(np.int64)
