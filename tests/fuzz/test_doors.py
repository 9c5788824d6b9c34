"""Mutated inputs are refused in one line or read as valid values, within limits of time and memory, at every door.

More of them: `python -m tests.fuzz.doors --inputs 5000`.
"""

import math

import pytest

from gri.errors import InputError
from tests.fuzz.doors import DOORS, Door, fuzz, mutated, problem_with

QUICK, MANY = 15, 145  # inputs of each door; together over 2,000


@pytest.mark.parametrize("door", DOORS, ids=lambda door: door.name)
def test_the_good_inputs_are_accepted(door: Door, tmp_path):
    for k, content in enumerate(door.good()):
        (tmp_path / f"good{k}{door.suffix}").write_bytes(content)
        if door.name != "additional file":  # a net stands for it, which only has to be XML
            assert problem_with(door, tmp_path / f"good{k}{door.suffix}") == ("accepted", "")


@pytest.mark.parametrize("door", DOORS, ids=lambda door: door.name)
def test_mutated_inputs_are_refused_or_valid(door: Door, tmp_path):
    counts, problems = fuzz(door, range(QUICK), tmp_path, megabytes=math.inf)
    assert not problems
    assert counts["refused"] >= QUICK / 4  # else the mutations do no harm


@pytest.mark.slow
@pytest.mark.parametrize("door", DOORS, ids=lambda door: door.name)
def test_many_mutated_inputs_are_refused_or_valid(door: Door, tmp_path):
    assert not fuzz(door, range(1000, 1000 + MANY), tmp_path, megabytes=math.inf)[1]


def test_an_input_can_be_made_again():
    for door in DOORS:
        assert mutated(door, 5) == mutated(door, 5)


def test_the_harness_finds_what_is_wrong(tmp_path):
    """Doors that break each promise on purpose."""

    def two_lines(path):
        raise InputError("one\ntwo")

    def crash(path):
        raise KeyError("field")

    def leaves_a_file(path):
        (path.parent / "half.part").touch()
        return 1.0

    for read, message in (
        (two_lines, "more than a line"),
        (crash, "KeyError"),
        (lambda path: {"a": [float("inf")]}, "accepted inf"),
        (leaves_a_file, "left"),
    ):
        folder = tmp_path / message
        folder.mkdir()
        door = Door("bad", ".yaml", lambda: (b"a: 1",), read, DOORS[0].mutations)
        assert message in fuzz(door, range(1), folder, megabytes=math.inf)[1][0]
