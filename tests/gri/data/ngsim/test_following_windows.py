"""Windows broken on purpose: motion stays consistent, and the reaction is gone."""

import numpy as np
import pytest
import torch

from gri.data.ngsim.following_windows import (
    BREAKS,
    HEADWAY,
    NOBODY,
    FollowingWindows,
    accelerations,
    joined,
    leaders_leader,
    lengthened,
    strangers,
    stretched,
)

DT = 0.2


def waves(scenes: int = 30, vehicles: int = 3, steps: int = 31, seed: int = 0) -> FollowingWindows:
    """Vehicles about 20 m apart; each repeats the speeds of the one ahead 1 s later. Every scene has its own time."""
    generator = torch.Generator().manual_seed(seed)
    time = torch.arange(steps, dtype=torch.float64) * DT
    phase = 6.3 * torch.rand((scenes, 1, 1), generator=generator, dtype=torch.float64)
    late = torch.arange(vehicles - 1, -1, -1, dtype=torch.float64)[:, None]
    v = 10 + torch.sin(0.9 * (time - late) + phase)
    moved = torch.cat([torch.zeros_like(v[..., :1]), ((v[..., 1:] + v[..., :-1]) / 2 * DT).cumsum(-1)], -1)
    x = moved + 20.0 * torch.arange(vehicles, dtype=torch.float64)[:, None]
    return FollowingWindows(
        torch.stack([x, v, accelerations(v, DT)], -1),
        torch.tensor([*range(1, vehicles), NOBODY]).repeat(scenes, 1),
        torch.arange(scenes * vehicles).reshape(scenes, vehicles),
        torch.full((scenes, vehicles), 2),
        1000 * torch.arange(scenes),
        np.full(scenes, "recorded", object),
        DT,
    )


@pytest.mark.parametrize("name", [*BREAKS, "strangers", "the leader's leader"])
def test_positions_stay_the_integral_of_speeds_and_the_order_is_kept(name):
    whole = {**BREAKS, "strangers": strangers, "the leader's leader": leaders_leader}
    broken = whole[name](waves())
    assert len(broken)
    assert set(broken.kind) == {name}
    x, v, a = broken.state.unbind(-1)
    assert torch.allclose(x[..., 1:] - x[..., :-1], (v[..., 1:] + v[..., :-1]) / 2 * DT)
    assert torch.allclose(a[..., :-1], (v[..., 1:] - v[..., :-1]) / DT)
    assert (broken.headways() >= HEADWAY[0]).all()
    assert (v >= 0).all()


def test_stretched_and_lengthened_headways():
    known = waves()
    assert torch.allclose(stretched(known, 4.0).headways()[..., 0], 4 * known.headways()[..., 0])
    far = lengthened(known, 60.0, "far")
    assert torch.allclose(far.headways(), known.headways() + 60)
    assert torch.equal(far.state[..., 1:], known.state[..., 1:])
    assert (far.leader == NOBODY).all()
    assert (known.leader[:, 0] == 1).all(), "the windows themselves are not changed"


def test_at_constant_speed_only_what_touches_that_vehicle_is_gone():
    known = waves()
    rear, middle = BREAKS["vehicle 0 at constant speed"](known), BREAKS["vehicle 1 at constant speed"](known)
    assert rear.leader.unique(dim=0).tolist() == [[NOBODY, 2, NOBODY]]
    assert middle.leader.unique(dim=0).tolist() == [[NOBODY, NOBODY, NOBODY]]
    for broken, vehicle in ((rear, 0), (middle, 1)):
        speed = broken.state[:, vehicle, :, 1]
        assert torch.allclose(speed, speed[:, :1].expand_as(speed))
        others = [k for k in range(3) if k != vehicle]
        assert torch.equal(broken.state[:, others], known.state[:, others])


def test_a_window_at_constant_speed_that_would_leave_the_range_is_left_out():
    known = waves()
    known.state[:15, 1:, :, 0] -= 13.5  # 6.5 m
    left = BREAKS["vehicle 0 at constant speed"](known)
    assert 15 <= len(left) < 30


def test_time_reversed_twice_is_the_same_motion():
    known = waves()
    once = BREAKS["time reversed"](known)
    twice = BREAKS["time reversed"](once)
    assert torch.allclose(twice.state[..., 1], known.state[..., 1])
    assert torch.allclose(twice.headways(), known.headways())
    assert torch.equal(once.vehicle, known.vehicle.flip(1))
    assert torch.allclose(once.state[:, 0, :, 1], known.state[:, 2, :, 1].flip(-1))


def test_strangers_are_of_other_windows_at_equal_speed_and_headway():
    known = waves()
    made = strangers(known, 2)
    assert len(made) > 30
    scene = made.vehicle // 3
    for first, second in ((0, 1), (1, 2), (0, 2)):
        assert (scene[:, first] != scene[:, second]).all()
    own = scene[:, 0]
    assert torch.equal(made.state[:, 0], known.state[own, 0])
    assert torch.allclose(made.headways()[..., 0], known.headways()[own, :, 0])
    mean = made.state[..., 1].mean(-1) - known.state[own, :, :, 1].mean(-1)
    assert mean.abs().max() <= 0.5
    assert (made.leader == NOBODY).all()


def test_no_stranger_from_the_same_lane_at_the_same_time():
    known = waves()
    together = FollowingWindows(**{**vars(known), "time": torch.zeros_like(known.time)})
    assert len(strangers(together)) == 0
    lanes = torch.arange(30)[:, None].expand(30, 3)
    assert len(strangers(FollowingWindows(**{**vars(together), "lane": lanes}))) > 0


def test_without_matching_speeds_there_is_no_stranger():
    known = waves()
    known.state[..., 1] += 3.0 * torch.arange(30)[:, None, None]
    assert len(strangers(known)) == 0


def test_the_leaders_leader_has_two_vehicles():
    known = waves()
    made = leaders_leader(known)
    assert torch.equal(made.state, known.state[:, [0, 2]])
    assert made.vehicle.shape == made.leader.shape == (30, 2)


def test_windows_are_chosen_and_joined():
    known = waves()
    both = joined([known[torch.tensor([3, 1])], known[torch.arange(30) < 4].named("again")])
    assert both.time.tolist() == [3000, 1000, 0, 1000, 2000, 3000]
    assert both.kind.tolist() == ["recorded"] * 2 + ["again"] * 4
