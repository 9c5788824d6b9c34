"""Recorded car following from files in the official layout: generated traffic, and the recordings where they are."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from gri.data.ngsim.following_triples import Part, read_sites, recorded_following, recorded_pairs
from gri.data.ngsim.following_windows import NOBODY, FollowingWindows
from gri.data.ngsim.rules import Rules
from gri.errors import InputError
from tests.gri.data.ngsim.conftest import CLOCK, as_text, platoon

LATER = CLOCK + 10**6


def traffic(folder: Path) -> Path:
    """Three vehicles in lane 2 and one between the first two in lane 3; later three more, in lanes 2, 3 and 4."""
    beside = platoon(1, first_id=10, lane=3)
    beside["Local_Y"] += 30.0
    apart = [platoon(1, first_id=20 + k, lane=2 + k, clock=LATER) for k in range(3)]
    for k, table in enumerate(apart):
        table["Local_Y"] += 50.0 * k
    tables = [platoon(3), beside, *apart, platoon(3, first_id=30, clock=LATER + 10**6)]
    return as_text(pd.concat(tables), folder / "us-101.txt")


@pytest.fixture(scope="module")
def kinds(tmp_path_factory) -> dict[str, FollowingWindows]:
    (site,) = read_sites([traffic(tmp_path_factory.mktemp("ngsim"))])
    return dict(recorded_following(site, 31, 3, "test", 40))


def test_each_vehicle_follows_the_next_in_recorded_windows(kinds):
    known = kinds["recorded"]
    assert known.vehicle.tolist() == [[1, 2, 3], [30, 31, 32]]
    assert known.leader.tolist() == [[1, 2, NOBODY]] * 2
    # 60 ft apart and 15 ft long: the gap is 45 ft, and vehicles of 5 m would be 5 m further apart
    assert known.headways().numpy() == pytest.approx(np.full(known.headways().shape, 45 * 0.3048 + 5), abs=1e-3)


def test_a_vehicle_between_in_the_next_lane_is_not_followed(kinds):
    known = kinds["one between, in the next lane"]
    assert known.vehicle.tolist() == [[1, 10, 2]]
    assert known.leader.tolist() == [[2, NOBODY, NOBODY]]


def test_vehicles_in_three_lanes_follow_nobody(kinds):
    known = kinds["different lanes"]
    assert known.vehicle.tolist() == [[20, 21, 22]]
    assert known.lane.tolist() == [[2, 3, 4]]
    assert (known.leader == NOBODY).all()


def test_three_strangers_need_three_times_or_lanes(kinds):
    assert "strangers" not in kinds  # there are two times, and one lane with followers


def test_pairs_have_strangers(tmp_path):
    made = recorded_pairs([traffic(tmp_path)], vehicles=2, split="test", stride=40, copies=1)
    known = made[torch.from_numpy(made.kind == "strangers")]
    early = known.vehicle < 30
    assert len(known) == 4
    assert (early[:, 0] != early[:, 1]).all()
    assert set(made.kind) >= {"recorded", "strangers", "the leader's leader", "headway x 15", "different lanes"}


def test_parts_are_apart_and_cover_everything():
    vehicle, rules = np.arange(3000)[:, None], Rules()
    every = sum(Part("test", fold).holds(vehicle, rules).astype(int) for fold in range(5))
    assert (every == 1).all()
    for fold in range(5):
        parts = [Part(split, fold).holds(vehicle, rules) for split in ("train", "validation", "test")]
        assert (sum(part.astype(int) for part in parts) == 1).all()
    assert not Part("test").holds(np.array([[199, 200]]), rules).any()


def test_a_part_without_windows_is_an_error(tmp_path):
    with pytest.raises(InputError, match="no window of 31 steps in split 'validation'"):
        recorded_pairs([traffic(tmp_path)], split="validation")


def test_the_recordings_give_windows_of_every_kind():
    folder = os.environ.get("GRI_NGSIM_DIR")
    if folder is None:
        pytest.skip("needs recorded data: set GRI_NGSIM_DIR to a folder with us-101.csv.gz and i-80.csv.gz")
    made = recorded_pairs([Path(folder) / "us-101.csv.gz"])
    counts = pd.Series(made.kind).value_counts()
    assert counts["recorded"] > 100
    assert counts["one between, in the next lane"] > 20
    assert bool(torch.isfinite(made.state).all())
