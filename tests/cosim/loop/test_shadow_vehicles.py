"""The lanes of a vehicle between two lanes and of its shadow."""

import numpy as np
import pytest

from cosim.loop.shadow_vehicles import ShadowPlacement, is_free, shadow_placement
from cosim.world.groups import MergeLanes
from cosim.world.snapshot import LaneStrip, Snapshot

# A lane 4 m wide that ends at s = 300, centre at d = -8, and to its left one 3.6 m wide, centre at d = -4.2.
LANES = MergeLanes(LaneStrip("weave_0", 100.0, 300.0, -8.0, 4.0), LaneStrip("weave_1", 100.0, 300.0, -4.2, 3.6))


@pytest.mark.parametrize(
    ("d", "expected"),
    [
        (-8.0, ShadowPlacement("", "weave_1", -4.2)),  # still in its lane: the shadow announces the merge
        (-6.5, ShadowPlacement("weave_0", "weave_1", -6.5)),  # its left side is across the line at d = -6
        (-5.5, ShadowPlacement("weave_1", "weave_0", -5.5)),  # its centre is across
        (-5.1, ShadowPlacement()),  # 0.9 m beyond the line: inside
    ],
)
def test_the_lanes_follow_the_body(d, expected):
    assert pytest.approx(LANES.boundary) == -6.0
    assert shadow_placement(200.0, d, 1.8, LANES) == expected


@pytest.mark.parametrize("s", [99.0, 301.0])
def test_no_shadow_where_the_lanes_are_not_side_by_side(s):
    assert shadow_placement(s, -6.0, 1.8, LANES) == ShadowPlacement()


def traffic(*s: float) -> Snapshot:
    n = len(s)
    return Snapshot(
        time=0.0,
        ids=tuple(str(k) for k in range(n)),
        xy=np.zeros((n, 2)),
        heading=np.zeros(n),
        v=np.full(n, 10.0),
        a=np.zeros(n),
        s=np.array(s),
        d=np.full(n, -4.2),
        length=np.full(n, 5.0),
        width=np.full(n, 1.8),
        lane=("weave_1",) * n,
    )


@pytest.mark.parametrize(
    ("others", "free"),
    [((190.0, 210.0), True), ((194.0,), False), ((201.0,), False), ((203.0,), False), ((192.4, 203.6), True)],
)
def test_a_merge_is_announced_only_where_the_shadow_pushes_nobody(others, free):
    """In 0.2 s the others move by 2 m; the shadow is 5 m long and keeps 0.5 m, so 194.5 to 205.5 m must be empty."""
    now = traffic(201.0, *others)  # its own place counts for nothing
    assert is_free(200.0, 5.0, LANES, now, 0, 0.2) is free
