"""What trackers write of a training, and that it goes on after a stop."""

import csv
import sys
from pathlib import Path

import pytest

from gri.errors import InputError
from gri.progress import no_progress
from gri.training.tracking import COLUMNS, remove_tracks, tracked


def test_a_csv_file_has_a_row_per_update_and_goes_on(tmp_path: Path) -> None:
    place = tmp_path / "runs" / "small.safetensors"
    heard: list[tuple] = []
    with tracked(lambda *step: heard.append(step), ["csv", "csv"], place) as progress:
        progress("policy", 1, 3, 0.1 + 0.2)
        written = place.with_suffix(".csv").read_text()
        assert written.count("\n") == 2, "a row is on the disk at once"
    with tracked(no_progress, ["csv"], place) as progress:
        progress("policy", 2, 3, 0.25)
    assert heard == [("policy", 1, 3, 0.1 + 0.2)]
    rows = [*csv.reader(place.with_suffix(".csv").read_text().splitlines())]
    assert tuple(rows[0]) == COLUMNS
    assert [row[:4] for row in rows[1:]] == [
        ["policy", "1", "3", "0.30000000000000004"],
        ["policy", "2", "3", "0.25"],
    ]
    remove_tracks(place)
    assert not [*place.parent.iterdir()]


def test_without_tensorboard_there_is_one_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard.writer", None)
    with (
        pytest.raises(InputError, match=r"pip install 'gri-cosim\[track\]'"),
        tracked(no_progress, ["tensorboard"], tmp_path / "small.safetensors"),
    ):
        pass


def test_tensorboard_reads_what_was_written(tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    place = tmp_path / "small.safetensors"
    for updates in ((1, 2), (3,)):  # stopped after two updates
        with tracked(no_progress, ["tensorboard"], place) as progress:
            for update in updates:
                progress("policy", update, 3, 1.0 / update)
    events = accumulator.EventAccumulator(str(place.with_suffix(".tensorboard")))
    events.Reload()
    read = {event.step: event.value for event in events.Scalars("objective/policy")}
    assert read == pytest.approx({1: 1.0, 2: 0.5, 3: 1 / 3})
