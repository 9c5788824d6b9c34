"""Windows of recordings for contrastive teaching."""

from pathlib import Path

import pytest

from gri.relations.reaction_scenes import UNSEEN
from gri.training.relations.recorded_windows import recorded_windows

FILE = Path(__file__).parents[5] / "shared" / "ngsim" / "i-80.csv.gz"


@pytest.mark.slow
@pytest.mark.skipif(not FILE.is_file(), reason="the NGSIM extracts are not here; they may not be redistributed")
def test_half_of_the_windows_are_recorded_and_the_others_broken():
    windows, known = recorded_windows([FILE], 30)
    follows = (windows.leader[:, 0] == 1) & (windows.leader[:, 1] == 2)
    assert int(follows.sum()) == len(known)
    assert 0.4 < float(follows.float().mean()) < 0.6
    assert bool((windows.leader[:, -1] == UNSEEN).all())
    strangers = (windows.leader == UNSEEN).all(1)
    assert float(strangers.float().mean()) > 0.3
    assert float((windows.x[:, 1:] - windows.x[:, :-1]).min()) > 0
