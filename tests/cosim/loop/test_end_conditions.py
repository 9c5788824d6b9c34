"""When a group is not driven any further."""

import numpy as np
import pytest

from cosim.loop.end_conditions import all_follow, car_following, merging
from cosim.loop.observation import GroupObservation
from cosim.world.episode import COLUMNS, Ending
from cosim.world.groups import MergeLanes, next_ahead
from cosim.world.snapshot import LaneStrip, Snapshot

LANES = MergeLanes(LaneStrip("weave_0", 100.0, 300.0, -8.0, 4.0), LaneStrip("weave_1", 100.0, 300.0, -4.2, 3.6))
ROWS = np.arange(3)


def snapshot(s, d, v=10.0) -> Snapshot:
    n = len(s)
    return Snapshot(
        time=0.0,
        ids=tuple(str(k) for k in range(n)),
        xy=np.zeros((n, 2)),
        heading=np.zeros(n),
        v=np.full(n, v),
        a=np.zeros(n),
        s=np.array(s, dtype=float),
        d=np.array(d, dtype=float),
        length=np.full(n, 5.0),
        width=np.full(n, 1.8),
        lane=("",) * n,
    )


def state(seen: Snapshot) -> np.ndarray:
    columns = {"s": seen.s, "d": seen.d, "v": seen.v}
    return np.stack([columns.get(name, np.zeros(len(seen.ids)))[:3] for name in COLUMNS], -1)


def merge(s, d, before_d=None, v=10.0) -> Ending | None:
    now = snapshot(s, d, v)
    before = snapshot(s[:3], before_d or d[:3], v)
    return merging(state(before), state(now), now, ROWS, LANES, 1.8, 0.2)


@pytest.mark.parametrize(
    ("ending", "s", "d"),
    [
        (None, (200, 190, 220), (-8.0, -4.2, -4.2)),
        (None, (200, 190, 220), (-5.2, -4.2, -4.2)),  # 0.1 m of its box is still across the line
        (Ending.MERGED, (200, 190, 220), (-5.0, -4.2, -4.2)),
        (Ending.CUT_IN, (200, 190, 220, 210), (-8.0, -4.2, -4.2, -4.2)),
        (None, (200, 190, 220, 230), (-8.0, -4.2, -4.2, -4.2)),
        (Ending.LANE_END, (298.5, 290, 310), (-6.1, -4.2, -4.2)),  # 2 m of the 1.5 m that are left
        (None, (298.5, 290, 310), (-5.9, -4.2, -4.2)),  # more than half across: the target lane carries it
        (None, (297.0, 290, 310), (-8.0, -4.2, -4.2)),
    ],
)
def test_merge(ending, s, d):
    assert merge(s, d) is ending


def test_a_merger_may_jump_to_the_other_lane_but_lag_and_leader_may_not():
    assert merge((200, 190, 220), (-4.2, -4.2, -4.2), before_d=(-8.0, -4.2, -4.2)) is Ending.MERGED
    assert merge((200, 190, 220), (-8.0, -0.6, -4.2), before_d=(-8.0, -4.2, -4.2)) is Ending.LANE_LEFT


def test_no_merge_is_completed_while_the_lag_vehicle_is_in_the_next_lane():
    """The target lane reaches from d = −6.0 to −2.4 m. Drifting out of it step by step ends no drive by itself."""
    assert merge((200, 190, 220), (-4.2, -2.5, -4.2), before_d=(-4.5, -2.6, -4.2)) is Ending.MERGED
    assert merge((200, 190, 220), (-4.2, -2.3, -4.2), before_d=(-4.5, -2.5, -4.2)) is Ending.LANE_LEFT
    assert merge((200, 190, 220), (-8.0, -2.3, -4.2), before_d=(-8.0, -2.5, -4.2)) is None


def test_car_following():
    chain, broken = snapshot((0, 10, 20), (0, 0, 0)), snapshot((0, 10, 20, 15), (0, 0, 0, 0))

    def ending(before: Snapshot, now: Snapshot) -> Ending | None:
        states = state(before)[None], state(now)[None]
        return car_following(*states, ROWS[None], next_ahead(now, ROWS[:2])[None])[0]

    assert ending(chain, chain) is None
    assert ending(broken, broken) is Ending.CUT_IN
    assert ending(chain, snapshot((0, 10, 20), (0, 3.5, 0))) is Ending.LANE_LEFT


@pytest.mark.parametrize("has_third_vehicle", [True, False])
def test_the_quick_look_ends_no_group_that_the_rule_would_end(has_third_vehicle):
    """Two groups among random vehicles in three lanes; now and then one is between, beside or level with another."""
    rng, quick, together = np.random.default_rng(5), 0, 0
    for _ in range(2000):
        order = rng.permutation(np.arange(8.0) * 10)
        d = rng.choice([0.0, 0.6, 3.5], 8, p=[0.5, 0.1, 0.4])
        s = np.where(rng.random(8) < 0.05, order[0], order)
        s[:3], s[3:6] = np.sort(s[:3]), np.sort(s[3:6])
        d[:3], d[3:6] = (np.where(rng.random(3) < 0.9, lane, d[:3]) for lane in (0.0, 3.5))
        now, rows = snapshot(s, d), np.arange(6).reshape(2, 3)
        before = snapshot(s, d + np.where(rng.random(8) < 0.02, 3.5, 0.0))
        seen = [GroupObservation(0.0, _features(at)[rows], np.ones((2, 3), bool), rows) for at in (before, now)]
        ahead = next_ahead(now, rows[:, :-1].ravel()).reshape(2, 2)
        endings = car_following(seen[0].state, seen[1].state, rows, ahead, has_third_vehicle)
        follows = all_follow(seen[0], seen[1], now, [0, 1], has_third_vehicle)
        assert endings == [None, None] or not follows
        quick, together = quick + follows, together + (endings == [None, None])
    assert 50 < together < 1900
    assert quick > 0.9 * together  # it is unsure where two vehicles are at the same place


def _features(seen: Snapshot) -> np.ndarray:
    columns = {"s": seen.s, "d": seen.d, "v": seen.v}
    return np.stack([columns.get(name, np.zeros(len(seen.ids))) for name in COLUMNS], -1)
