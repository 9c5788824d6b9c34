"""Markdown tables."""

import pytest

from cosim.process.markdown_table import markdown_table


def test_pipes_in_cells_are_escaped():
    lines = list(markdown_table(["policy", "|jerk| [m/s³]"], [["idm", "1.0"]]))
    assert lines == ["| policy | \\|jerk\\| [m/s³] |", "| --- | --- |", "| idm | 1.0 |"]


def test_a_row_of_another_length_is_refused():
    with pytest.raises(AssertionError, match="got 1 cells, wanted 2"):
        list(markdown_table(["a", "b"], [["1"]]))
