"""Tables: no line is too long and no cell is cut in a terminal; Markdown renders; CSV and JSON hold the numbers."""

import csv
import io
import json
import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gri.table import NBSP, Table, csv_text, json_text, markdown_table, markdown_text, terminal_text

WORDS = st.text("abcdefgh0123456789.[]|%", min_size=1, max_size=14)
CELLS = st.lists(WORDS, max_size=4).map(" ".join)


@st.composite
def columns_and_lines(draw: st.DrawFn) -> tuple[list[str], list[list[str]], int]:
    columns = draw(st.integers(1, 12))
    lines = draw(st.lists(st.lists(CELLS, min_size=columns, max_size=columns), max_size=6))
    head = draw(st.lists(CELLS.filter(bool), min_size=columns, max_size=columns))
    return head, lines, draw(st.integers(0, columns))


@settings(deadline=None, max_examples=80)
@given(parts=columns_and_lines(), width=st.sampled_from([40, 80, 120]))
def test_no_line_is_too_long_and_nothing_is_cut(parts: tuple[list[str], list[list[str]], int], width: int):
    head, lines, labels = parts
    text = terminal_text(Table("any", head, lines, [], labels=labels), width)
    assert all(len(line) <= width for line in text.splitlines())
    shown = Counter(text)
    for character, count in Counter("".join(cell for line in lines for cell in line)).items():
        assert character == " " or shown[character] >= count


def test_lines_that_differ_in_the_last_label_stand_side_by_side():
    many = wide(8)
    lines = [[str(i // 4), *line[1:]] for i, line in enumerate(many.lines)]
    text = terminal_text(Table("wide", many.head, lines, [], labels=2), 90)
    shown = [line.split()[1:] for line in text.splitlines() if line.startswith("intensity")]
    assert shown == [["0"] * 4, ["1"] * 4]


def wide(rows: int, labels: int = 2) -> Table:
    head = ["intensity", "policy", *(f"measure {k} [m/s²]" for k in range(7))]
    lines = [["1", f"policy{i}", *(f"{i}.{k} (1.0{NBSP}to{NBSP}2.0)" for k in range(7))] for i in range(rows)]
    return Table("wide", head, lines, [], title="A title", note="A note.", labels=labels)


def test_a_wide_table_swaps_rows_and_columns():
    lines = terminal_text(wide(3), 80).splitlines()
    assert lines[0] == "A title"
    assert lines[1].split() == ["intensity", "1", "1", "1"]
    assert lines[2].split() == ["policy", "policy0", "policy1", "policy2"]
    assert lines[4] == "measure 0 [m/s²]  0.0 (1.0 to 2.0)  1.0 (1.0 to 2.0)  2.0 (1.0 to 2.0)"
    assert lines[-1] == "A note."


def test_many_lines_become_blocks_and_intervals_stay_whole():
    text = terminal_text(wide(8), 80)
    assert sum(line.startswith("policy") for line in text.splitlines()) == 2, "two blocks"
    assert text.count("(1.0 to 2.0)") == 8 * 7
    assert NBSP not in text


def test_a_narrow_table_stays_as_it_is():
    table = Table("x", ["", "b [m]"], [["one", "1"], ["  part of one", "22"]], [])
    assert terminal_text(table, 80).splitlines() == [
        "               b [m]",
        "─────────────  ─────",
        "one                1",
        "  part of one     22",
    ]


def test_pipes_and_line_breaks_do_not_break_markdown():
    assert markdown_table(["|jerk|", "b"], [["1", "x\ny"]]) == "| \\|jerk\\| | b |\n| --- | --- |\n| 1 | x<br>y |\n"
    text = markdown_text(wide(1))
    assert text.startswith("**A title**\n\n| intensity | policy |")
    assert text.endswith("\n\nA note.\n")


def test_lines_have_as_many_cells_as_the_header():
    with pytest.raises(ValueError, match="got 1 cells"):
        markdown_table(["a", "b"], [["1"]])
    with pytest.raises(ValueError, match="got 1 cells"):
        Table("x", ["a", "b"], [["1"]], [])


def test_csv_and_json_hold_every_digit():
    third = np.float64(1 / 3)
    records = [{"driver": "a, b", "gap": third, "n": np.int64(3)}, {"driver": "c", "gap": math.nan, "ttc": math.inf}]
    table = Table("groups", ["driver"], [["a"], ["c"]], records)
    rows = list(csv.DictReader(io.StringIO(csv_text(table))))
    assert float(rows[0]["gap"]) == 1 / 3
    assert rows[0] == {"driver": "a, b", "gap": rows[0]["gap"], "n": "3", "ttc": ""}
    assert rows[1] == {"driver": "c", "gap": "", "n": "", "ttc": "inf"}
    content = json.loads(json_text([table]))
    assert content == {"groups": [{"driver": "a, b", "gap": 1 / 3, "n": 3}, {"driver": "c", "gap": None, "ttc": None}]}
