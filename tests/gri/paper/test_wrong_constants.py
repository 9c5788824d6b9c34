from pathlib import Path

import msgspec
import pytest
import torch

from gri.core.scenes import Scenes
from gri.errors import InputError
from gri.paper import wrong_constants
from gri.paper.wrong_constants import Case, measure, with_strangers
from gri.training.grounded.constants_search import ConstantsSearch

SMALL = ConstantsSearch(draws=1, screening_scenes=2, scenes=4, rounds=((1, 1),), batch=2)


def test_a_stranger_has_the_first_headway_and_another_motion(generator: torch.Generator):
    state = torch.randn(5, 3, 6, 3, generator=generator)
    scenes = Scenes(state, torch.randn(5, 2, 5, 1, generator=generator), torch.zeros(5, 6, dtype=torch.long))
    changed = with_strangers(scenes)
    torch.testing.assert_close(changed.state[:, 1, 0, 0], state[:, 1, 0, 0])
    torch.testing.assert_close(changed.state[1:, 1, :, 1], state[:-1, 1, :, 1])
    torch.testing.assert_close(changed.action[1:, 1], scenes.action[:-1, 1])
    assert torch.equal(changed.state[:, [0, 2]], state[:, [0, 2]])


def test_finished_cases_are_kept_and_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(wrong_constants, "CASES", (Case("all x2", wrong_constants._all(2.0), SMALL), Case("other")))
    data = {"idm": msgspec.structs.replace(wrong_constants.EXPERTS["idm"], train=6)}
    monkeypatch.setattr(wrong_constants, "EXPERTS", data)
    frame = measure(1, 8, tmp_path, tmp_path, cases=("all x2",))
    assert frame["untrained_accuracy"].between(0, 1).all()
    assert frame["learned_time_headway"].iloc[0] > 0
    monkeypatch.setattr(wrong_constants, "measure_case", None)
    again = measure(1, 8, tmp_path, tmp_path, finished=True)
    assert again.equals(frame)
    text = wrong_constants.page(again)
    assert "## idm" in text
    assert "| all x2 |" in text
    assert "| other |" not in text


def test_unknown_names_and_nothing_finished_are_errors(tmp_path: Path):
    with pytest.raises(InputError, match="got scenario parking for constants, wanted one of policy"):
        measure(1, 8, tmp_path, tmp_path, expert="parking")
    with pytest.raises(InputError, match="got row x9 for constants, wanted one of the expert's own"):
        measure(1, 8, tmp_path, tmp_path, cases=("x9",))
    with pytest.raises(InputError, match="nothing is finished"):
        measure(1, 8, tmp_path, tmp_path, finished=True)
