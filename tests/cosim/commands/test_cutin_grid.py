"""`cosim cutin-grid` as a person uses it."""

import json
import subprocess
import sys

import pytest

from cosim.commands.cutin_grid import _grids, _range
from gri.errors import InputError


def cutin_grid(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "cosim", "cutin-grid", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


def test_the_command_prints_collisions_and_preventable_ones(tmp_path):
    done = cutin_grid("--policy", "r157,fsm", "--ego", "20", "--out", str(tmp_path / "out"), "--format", "json")
    assert done.returncode == 0, done.stderr
    tables = json.loads(done.stdout)
    assert [(row["policy"], row["collisions"]) for row in tables["collisions_own"]] == [("r157", 74), ("fsm", 17)]
    assert {row["benchmark"] for row in tables["preventable_own"]} == {"r157", "careful_human", "fsm", "rss"}
    assert (tmp_path / "out/cells.csv").is_file()


def test_ranges_include_their_end():
    assert _range("ego", "20:60:20") == (20, 40, 60)
    assert _range("lateral", "0.5") == (0.5,)
    assert _range("lateral", "0:1.7:0.1")[-1] == pytest.approx(1.7)


@pytest.mark.parametrize("text", ["20:60", "a", "60:20:10", "0:1:0", "nan", "0:1e9:0.001", "1:2:3:4"])
def test_ranges_that_are_none_are_refused(text):
    with pytest.raises(InputError, match="--ego"):
        _range("ego", text)


def test_own_ranges_replace_those_of_one_grid():
    grid = _grids("high", {"ego": "90", "other": "", "gap": "5:9:2", "lateral": "1"})["own"]
    assert sorted(set(grid.other)) == [10, 40, 70]
    assert len(grid) == 3 * 3
    with pytest.raises(InputError, match="both"):
        _grids("both", {"ego": "90", "other": "", "gap": "", "lateral": ""})


def test_code_needs_to_be_trusted():
    done = cutin_grid("--policy", "mine.py:Policy")
    assert done.returncode == 2
    assert "--allow-code" in done.stderr
