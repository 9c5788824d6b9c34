"""Windows of recordings for contrastive teaching."""

import pytest
import torch

from gri.data.ngsim.following_triples import Site, read_sites
from gri.errors import InputError
from gri.relations.reaction_scenes import UNSEEN
from gri.training.relations.recorded_windows import ContrastSettings, contrast_windows
from tests.gri.bench.recorded_traffic import waves_file

SETTINGS = ContrastSettings(copies=2, stride=5)


@pytest.fixture(scope="module")
def sites(tmp_path_factory) -> list[Site]:
    return read_sites([waves_file(tmp_path_factory.mktemp("recording"))])


def test_half_of_the_probability_is_that_of_recorded_windows(sites: list[Site]):
    for vehicles, group in zip((2, 3), contrast_windows(sites, SETTINGS), strict=True):
        assert len(group) == 1  # the tracks are too short for 12 s
        windows, weight = group[0].windows, group[0].weight
        assert windows.x.shape[1:] == (vehicles, 31)
        chain = torch.tensor([*range(1, vehicles), UNSEEN])
        recorded = (windows.leader == chain).all(1)
        assert float(weight[recorded].sum() / weight.sum()) == pytest.approx(0.5, abs=1e-6)
        assert float((windows.x[:, 1:] - windows.x[:, :-1]).min()) > 0


def test_recordings_without_followers_say_what_was_wanted(sites: list[Site]):
    with pytest.raises(InputError, match="in which no 2 vehicles follow each other for 400 states"):
        contrast_windows(sites, ContrastSettings(steps=(400,), shares=(1.0,)))
