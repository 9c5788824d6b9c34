"""Progress where there is no terminal, and text that contains square brackets."""

import io
import re
import sys

import pytest

from gri.table import Table
from gri.terminal import ProgressDisplay, _clock, errors, next_command, say, show_tables, use_any_encoding

pytestmark = pytest.mark.skipif(errors.is_terminal, reason="lines are written where there is no terminal")


def lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return [line for line in capsys.readouterr().err.splitlines() if line]


def test_a_log_has_a_first_line_and_one_for_every_tenth(capsys: pytest.CaptureFixture[str]):
    with ProgressDisplay() as progress:
        for done in (7, 99, 101, 102, 350, 1000):
            progress("reading", done, 1000, 0.5)
    shown = lines(capsys)
    assert [line.split(",")[0] for line in shown] == [
        "reading: 7/1000", "reading: 101/1000", "reading: 350/1000", "reading: 1000/1000",
    ]  # fmt: skip
    assert shown[0] == "reading: 7/1000, 0.5"
    assert re.fullmatch(r"reading: 350/1000, 0\.5, [\d.]+/s, \d+ s left", shown[2])


def test_long_work_writes_few_lines(capsys: pytest.CaptureFixture[str]):
    with ProgressDisplay() as progress:
        for done in range(5001):
            progress("runs", done, 5000, "1 failed" if done > 2000 else "")
    shown = lines(capsys)
    assert len(shown) == 11
    assert shown[0] == "runs: 0/5000"
    assert shown[-1].startswith("runs: 5000/5000, 1 failed, ")


def test_a_stage_that_begins_again_is_shown_again(capsys: pytest.CaptureFixture[str]):
    with ProgressDisplay() as progress:
        for done in (1, 2, 1, 2):
            progress("fold", done, 2)
    assert [line.split(",")[0] for line in lines(capsys)] == ["fold: 1/2", "fold: 2/2"] * 2


def test_nothing_to_do_is_no_error(capsys: pytest.CaptureFixture[str]):
    with ProgressDisplay() as progress:
        progress("runs", 0, 0)
    assert lines(capsys) == ["runs: 0/0"]


@pytest.mark.parametrize(("seconds", "text"), [(3.4, "3 s"), (61.0, "1 min 01 s"), (3725.0, "1 h 02 min")])
def test_remaining_time(seconds: float, text: str):
    assert _clock(seconds) == text


def test_square_brackets_are_text(capsys: pytest.CaptureFixture[str]):
    say("minimum gap [m]: 3")
    next_command("cosim run 'my [s].yaml'")
    assert capsys.readouterr().out == "minimum gap [m]: 3\nNext: cosim run 'my [s].yaml'\n"


def test_formats_for_programs_leave_standard_output_to_the_table(capsys: pytest.CaptureFixture[str]):
    table = Table("sizes", ["name", "size [m]"], [["a", "0.33"]], [{"name": "a", "size": 1 / 3}])
    show_tables([table], "csv", "3 s", then="cosim list")
    done = capsys.readouterr()
    assert (done.out, done.err) == (f"name,size\na,{1 / 3!r}\n", "3 s\n")
    show_tables([table], "table", "3 s", then="cosim list")
    done = capsys.readouterr()
    assert done.out.splitlines() == ["name  size [m]", "────  ────────", "a         0.33", "3 s", "Next: cosim list"]


@pytest.mark.parametrize(("encoding", "written"), [("ascii", b"-3.5 m/s2 >= ?"), ("latin-1", b"-3.5 m/s\xb2 >= ?")])
def test_a_terminal_without_unicode_shows_what_it_has(encoding: str, written: bytes, monkeypatch: pytest.MonkeyPatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", stream)
    use_any_encoding()
    say("−3.5 m/s² ≥ ☃")
    stream.flush()
    assert stream.buffer.getvalue().splitlines() == [written]
