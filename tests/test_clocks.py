"""A clock that is put back or forward changes no wait, no limit and no duration: the monotonic clock measures them."""

import ast
from pathlib import Path

import gri

ROOT = Path(gri.__file__).parents[1]
WALL = {
    "time.time",
    "time.time_ns",
    "datetime.now",
    "datetime.utcnow",
    "datetime.today",
    "date.today",
    "time.localtime",
}
ALLOWED = {
    "gri/storage/verification.py": "how old a file is: tests/gri/storage/test_verification.py lets the clock jump",
    "gri/storage/scratch.py": "how old a folder of a killed command is",
    "gri/storage/claims.py": "since when a folder is claimed, for people to read",
    "cosim/show/export/commonroad.py": "the date in an exported file",
}


def clocks(source: str) -> set[str]:
    """The calls of the clock on the wall in a module."""
    calls = (ast.unparse(node.func) for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call))
    return {call for call in calls if call.removeprefix("datetime.") in WALL or call in WALL}


def test_only_records_for_people_and_the_age_of_files_use_the_clock_on_the_wall():
    found = {
        str(path.relative_to(ROOT))
        for package in ("gri", "cosim")
        for path in (ROOT / package).rglob("*.py")
        if clocks(path.read_text(encoding="utf-8"))
    }
    assert found == set(ALLOWED)


def test_the_search_finds_them():
    assert clocks("import time\ndeadline = time.time() + 5") == {"time.time"}
    assert clocks("a = datetime.datetime.now(UTC)") == {"datetime.datetime.now"}
    assert not clocks("a = time.monotonic(), time.process_time()")
