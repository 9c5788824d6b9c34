"""Rows that learn from recordings: what they find in generated traffic, and that they cannot find what is not there."""

import pytest
import torch

from gri.bench.learned_driver import learn_driver
from gri.bench.recorded_rows import RECORDED_ROWS, speed_correlation
from gri.bench.recorded_sets import Recordings, as_scenes, balanced
from gri.bench.scores import auc
from gri.bench.speed_gaussian import fit_gaussians
from gri.data.ngsim.following_triples import read_sites
from tests.gri.bench.recorded_traffic import waves_file


@pytest.fixture(scope="module", params=[True, False], ids=["reacts", "does not react"])
def known(request, tmp_path_factory):
    path = waves_file(tmp_path_factory.mktemp("recording"), request.param)
    return request.param, Recordings(tuple(read_sites([path])))


def ranked(recordings: Recordings, infer) -> float:
    parts = recordings.windows(recordings.sites[0], "6 s", "pairs", "test", 0)
    p = [infer(as_scenes(parts[kind]))[:, 1] for kind in ("recorded", "strangers")]
    truth = torch.cat([torch.ones(len(p[0])), torch.zeros(len(p[1]))]) > 0
    return auc(torch.cat(p).numpy()[:, None], truth.numpy()[:, None])


def test_rows_see_a_reaction_only_where_there_is_one(known):
    reacts, recordings = known
    train = recordings.training("6 s", "pairs", 0, ("recorded", "strangers"))
    recorded = train[torch.from_numpy(train.kind == "recorded")]
    rows = {
        "correlation": speed_correlation,
        "Gaussian": fit_gaussians(train),
        "driver": learn_driver(recorded, 0),
    }
    for name, infer in rows.items():
        value = ranked(recordings, infer)
        assert (value > 0.75) if reacts else (0.2 < value < 0.8), (name, value)


def test_teaching_and_testing_share_no_vehicle(known):
    _, recordings = known
    for fold in range(5):
        train = recordings.training("6 s", "pairs", fold, ("recorded", "strangers"))
        tested = recordings.windows(recordings.sites[0], "6 s", "pairs", "test", fold)
        for part in tested.values():
            assert not set(train.vehicle.flatten().tolist()) & set(part.vehicle.flatten().tolist())


def test_balanced_windows_are_half_recorded(known):
    _, recordings = known
    windows = balanced(recordings.training("6 s", "pairs", 0, ("recorded", "strangers")))
    assert 0.35 < float((windows.kind == "recorded").mean()) < 0.65


def test_every_row_says_what_it_was_given():
    assert all(row.given for row in RECORDED_ROWS)
