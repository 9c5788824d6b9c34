import gzip
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gri.data.ngsim import reading
from gri.data.ngsim.reading import read_chunks
from gri.data.ngsim.recordings import Recording, recordings, store_recordings
from gri.errors import InputError
from tests.gri.data.ngsim.conftest import CLOCK, as_portal, as_text, platoon


def read(path: Path, site: str | None = None) -> list[Recording]:
    return list(recordings(path, site))


def test_text_csv_gzip_and_zip_hold_the_same(tmp_path: Path):
    table = platoon()
    text = as_text(table, tmp_path / "us-101.txt")
    csv = tmp_path / "us-101.csv"
    table.to_csv(csv, index=False)
    zipped, packed = tmp_path / "us-101.zip", tmp_path / "us-101.csv.gz"
    with zipfile.ZipFile(zipped, "w") as archive:
        archive.write(text, "folder/trajectories.txt")
    packed.write_bytes(gzip.compress(csv.read_bytes()))
    (first,) = read(text)
    assert (first.site, first.clock, len(first.rows)) == ("us-101", CLOCK, 240)
    for path in (csv, zipped, packed):
        (other,) = read(path)
        assert (other.site, other.clock) == (first.site, first.clock)
        np.testing.assert_array_equal(other.rows, first.rows)


def test_portal_csv_is_separated_by_site_and_period(tmp_path: Path):
    second = platoon(clock=CLOCK + 930_000)  # vehicles of the same numbers, 15.5 min later
    tables = {"us-101": pd.concat([platoon(), second]), "i-80": platoon(2, clock=1113433135300)}
    counts = read(as_portal(tables, tmp_path / "portal.csv"))
    assert [(r.site, r.clock, len(r.rows)) for r in counts] == [
        ("i-80", 1113433135300, 160),
        ("us-101", CLOCK, 240),
        ("us-101", CLOCK + 930_000, 240),
    ]


def test_chunks_smaller_than_a_recording_make_the_same_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = as_text(platoon(), tmp_path / "a.txt")
    whole = read(path)[0].rows
    monkeypatch.setattr(reading, "CHUNK", 17)
    assert [len(table) for table in read_chunks(path)][:2] == [17, 17]
    np.testing.assert_array_equal(read(path)[0].rows, whole)


def test_site_is_given_by_the_option_the_name_or_the_day(tmp_path: Path):
    assert read(as_text(platoon(), tmp_path / "trajectories-0805am-0820am.txt"))[0].site == "us-101"
    assert read(as_text(platoon(), tmp_path / "i80.txt"))[0].site == "i-80"
    assert read(as_text(platoon(), tmp_path / "mine.txt"), "elsewhere")[0].site == "elsewhere"


def test_rows_that_are_not_numbers_are_counted(tmp_path: Path):
    path = tmp_path / "us-101.csv"
    table = platoon().astype(object)
    table.loc[5, "Local_Y"] = "n/a?"
    table.to_csv(path, index=False)
    store = store_recordings(path, tmp_path)
    assert dict(store.unreadable) == {"us-101": 1}
    assert sum(len(recording.rows) for recording in store) == 239


def test_truncated_gzip_is_one_clear_error(tmp_path: Path):
    path = tmp_path / "us-101.csv.gz"
    content = gzip.compress(platoon().to_csv(index=False).encode())
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match="truncated"):
        read(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"Vehicle_ID,Frame_ID,Global_Time\n1,2,3\n", "column local_x is missing"),
        (b"1 2 3 4\n", "4 columns and no header"),
        (",".join(platoon().columns).encode() + b"\n", "has no rows"),
    ],
)
def test_files_that_are_not_ngsim_are_one_clear_error(tmp_path: Path, content: bytes, message: str):
    path = tmp_path / "file.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read(path)


def test_clock_that_does_not_fit_the_frames_is_an_error(tmp_path: Path):
    table = platoon(8, 80)
    table["Global_Time"] = CLOCK + 7 * np.arange(len(table))
    with pytest.raises(InputError, match="belong together"):
        read(as_text(table, tmp_path / "us-101.txt"))


def test_missing_file_is_an_error(tmp_path: Path):
    with pytest.raises(InputError, match="no such file"):
        read(tmp_path / "nothing.txt")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        pytest.param(b"1 " * 10**6, "a line of more than 100000 bytes", id="line"),
        pytest.param(
            b"1 " * 17 + b"1\n" * 4 * 10**7,
            "unpacks to more than 200 times its size",
            id="bomb",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_recording_that_would_fill_the_memory_is_refused(tmp_path, content, message):
    (tmp_path / "bad.txt.gz").write_bytes(gzip.compress(content, 1))
    with pytest.raises(InputError, match=message):
        list(read_chunks(tmp_path / "bad.txt.gz"))
