"""docs/coupling.md names the test of every guarantee; each of them exists."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent
TEXT = (ROOT.parent / "docs/coupling.md").read_text()
NAMED = sorted(set(re.findall(r"`(\w+/test_\w+\.py)(?:::(test_\w+))?`", TEXT)))


@pytest.mark.parametrize(("file", "function"), NAMED)
def test_the_named_test_exists(file, function):
    source = (ROOT / "cosim" / file).read_text()
    assert not function or f"def {function}(" in source


def test_tests_are_named():
    assert len(NAMED) > 20
