"""docs/architecture.md says of every room what it does, and its picture shows the layers of the import contracts."""

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = runpy.run_path(str(ROOT / "docs/tools/rooms.py"))
TABLES = ROOMS["rooms_of_page"]((ROOT / "docs/architecture.md").read_text())


@pytest.mark.parametrize("package", ["cosim", "gri"])
def test_the_tables_list_the_rooms_of_the_contracts_in_their_order(package):
    assert list(TABLES[package]) == [room for layer in ROOMS["layers"]()[package] for room in layer]


def test_the_picture_is_drawn_from_the_contracts():
    assert (ROOT / "docs/images/rooms.svg").read_text() == ROOMS["draw"](), "run `python docs/tools/rooms.py`"


@pytest.mark.parametrize("package", ["cosim", "gri"])
def test_words_fit_into_their_boxes(package):
    for layer in ROOMS["layers"]()[package]:
        width = 920 / len(layer) - 30  # [px]
        for room in layer:
            assert 5.8 * len(TABLES[package][room][0]) < width, f"{package}/{room}: shorten its line in the table"
