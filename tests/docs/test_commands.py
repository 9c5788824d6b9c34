"""docs/reference/commands.md is what the commands say of themselves."""

import runpy
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_page_is_what_the_commands_say():
    written = runpy.run_path(str(ROOT / "docs/tools/commands.py"))["markdown"]()
    assert (ROOT / "docs/reference/commands.md").read_text() == written, "run `python docs/tools/commands.py`"
