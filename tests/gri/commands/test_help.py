"""`gri --help` and the help of all its commands; what mistakes need not wait for."""

import re

import pytest

from gri.commands.cli import app
from tests import help_pages

UNITS = {("ngsim scenes", "[m]"), ("scenes make", "[m]"), ("scenes inspect", "[m]"), ("scenes tidy", "[m]")}


@pytest.fixture(scope="module")
def pages() -> dict[str, tuple[object, str]]:
    return help_pages.pages(app)


def test_help_shows_every_text_with_its_units(pages):
    help_pages.assert_texts_with_units(pages, UNITS)


def test_help_fits_eighty_columns_and_is_not_cut(pages):
    help_pages.assert_fits_eighty_columns(pages)


def test_commands_stand_in_the_order_in_which_one_uses_them(pages):
    listed = pages[""][1].partition("Commands:")[2]
    assert re.findall(r"^  (\w+)", listed, re.MULTILINE) == [
        "data",
        "train",
        "teach",
        "evaluate",
        "infer",
        "reproduce",
        "scenes",
        "ngsim",
        "bench",
    ]


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["--help"], 0, "evaluate"),
        (["ngsim", "scenes", "--help"], 0, "--window"),
        (["scenes", "make", "--help"], 0, "--split"),
        (["--version"], 0, "gri 0."),
        (["fly"], 2, "No such command"),
        (["train", "no_such_configuration"], 2, "paper_car_following"),
        (["reproduce", "table9"], 2, "wanted one of table1"),
        (["reproduce", "table2"], 2, "give --ngsim FOLDER"),
    ],
)
def test_help_and_mistakes_do_not_wait_for_torch(arguments: list[str], code: int, text: str):
    imported, printed, exit_code = help_pages.imported_by("gri.commands.cli", *arguments)
    assert (exit_code, imported) == (code, set()), printed
    assert text in printed
