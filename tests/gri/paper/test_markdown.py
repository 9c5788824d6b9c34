import pytest

from gri.paper.markdown import markdown_table


def test_cells_cannot_break_a_table():
    assert markdown_table(["a", "b|c"], [["1", "x\ny"]]) == "| a | b\\|c |\n| --- | --- |\n| 1 | x y |\n"


def test_lines_have_as_many_cells_as_the_header():
    with pytest.raises(ValueError, match="got 1 cells"):
        markdown_table(["a", "b"], [["1"]])
