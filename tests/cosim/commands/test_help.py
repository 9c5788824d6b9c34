"""`cosim --help` and the help of all its commands; what mistakes need not wait for."""

import subprocess
import sys

import pytest

from cosim.commands.cli import app
from tests import help_pages

UNITS = {("traffic", "[s]"), ("calibrate", "[km/h]"), ("realism", "[m]"), ("scenes", "[m]"), ("scenes", "[s]")}


@pytest.fixture(scope="module")
def pages() -> dict[str, tuple[object, str]]:
    return help_pages.pages(app)


def test_help_shows_every_text_with_its_units(pages):
    help_pages.assert_texts_with_units(pages, UNITS)


def test_help_fits_eighty_columns_and_is_not_cut(pages):
    help_pages.assert_fits_eighty_columns(pages)


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["--help"], 0, "calibrate"),
        (["scenes", "--help"], 0, "--per-seed"),
        (["--version"], 0, "cosim 0."),
        (["fly"], 2, "No such command"),
        (["batch", "no_such_batch"], 2, "no_such_batch"),
        (["run", "no_such_scenario"], 2, "no_such_scenario"),
        (["scenes", "us101_merge", "--out", "x", "--kind", "weave"], 2, "wanted one of car_following, merge, triple"),
        (["traffic", "no_such_scenario"], 2, "no_such_scenario"),
        (["scenes", "no_such_scenario", "--out", "x"], 2, "no_such_scenario"),
        (["stress", "us101_merge", "--intensity", "much"], 2, "expected numbers"),
    ],
)
def test_help_and_mistakes_do_not_wait_for_torch(arguments: list[str], code: int, text: str):
    imported, printed, exit_code = help_pages.imported_by("cosim.commands.cli", *arguments)
    assert (exit_code, imported) == (code, set()), printed
    assert text in printed


@pytest.mark.parametrize("arguments", [["report", "no_such_folder"], ["results", "no_such_folder"]])
def test_reading_results_needs_neither_torch_nor_sumo(arguments: list[str]):
    """The folder is looked for when everything has been imported."""
    imported, printed, exit_code = help_pages.imported_by("cosim.commands.cli", *arguments)
    assert "no_such_folder" in printed
    assert exit_code == 2
    assert "pandas" in imported
    assert not imported & {"torch", "libsumo"}


@pytest.mark.parametrize(
    ("module", "unused"),
    [
        ("cosim.runs.run", {"torch", "libsumo", "pandas", "scipy", "matplotlib"}),  # the process that waits for a run
        ("cosim.runs.run_job", {"torch", "pandas", "scipy", "matplotlib"}),  # the process that does it, until it drives
        ("cosim.runs.run_writing", {"scipy", "matplotlib"}),  # until it draws
        ("cosim.show.batch_report", {"torch", "libsumo"}),
    ],
)
def test_nothing_is_imported_before_it_is_needed(module: str, unused: set[str]):
    code = f"import sys, {module}; print(*{unused!r} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert not done.stdout.split()
