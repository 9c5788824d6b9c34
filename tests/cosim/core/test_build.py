"""Which core runs and why, how it is built, and what a person reads where it cannot be."""

from pathlib import Path

import numpy as np
import pytest

from cosim.commands.cli import main
from cosim.core import build
from cosim.core.build import CoreStatus, build_core, core_status
from cosim.core.numpy_loops import _gives_the_same, _loop, loops
from gri.errors import InputError
from tests.command_line import in_this_process


@pytest.fixture(autouse=True)
def _anew(monkeypatch, tmp_path):
    """Nothing is built yet, and the answer of another test does not count."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("COSIM_CORE")
    core_status.cache_clear()
    yield
    core_status.cache_clear()


def test_without_a_built_core_python_runs_and_the_reason_says_how_to_build_one():
    status = core_status()
    assert status.library is None
    assert "cosim doctor --build-core" in status.reason


def test_the_switch_chooses(monkeypatch):
    monkeypatch.setenv("COSIM_CORE", "python")
    assert core_status() == CoreStatus(None, "COSIM_CORE is python")


@pytest.mark.parametrize(("value", "said"), [("compiled", "no core is built"), ("fast", "wanted one of auto, python")])
def test_a_switch_that_cannot_be_followed_is_an_error(value, said, monkeypatch):
    monkeypatch.setenv("COSIM_CORE", value)
    with pytest.raises(InputError, match=said):
        core_status()


def test_without_a_compiler_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setenv("CXX", "no-such-compiler")
    with pytest.raises(InputError, match=r"no C\+\+ compiler"):
        build_core()


def test_an_error_of_the_compiler_is_shown_and_nothing_is_kept(monkeypatch, tmp_path):
    if build._compiler() is None:
        pytest.skip("there is no C++ compiler")
    broken = tmp_path / "broken.cpp"
    broken.write_text("int broken( {")
    monkeypatch.setattr(build, "SOURCE", broken)
    with pytest.raises(InputError, match=r"broken\.cpp"):
        build_core()
    assert not [path for path in tmp_path.rglob("*") if ".so" in path.name]


def test_a_core_is_built_once_and_used_from_then_on(monkeypatch):
    try:
        first = build_core()
    except InputError as error:
        pytest.skip(f"no compiled core: {error}")
    assert core_status().library == first
    monkeypatch.setattr(build.subprocess, "run", lambda *_, **__: pytest.fail("compiled again"))
    assert build_core() == first


def test_another_source_is_another_core(monkeypatch, tmp_path):
    before = build._library_file()
    other = tmp_path / "other.cpp"
    other.write_bytes(build.SOURCE.read_bytes() + b"\n")
    monkeypatch.setattr(build, "SOURCE", other)
    assert isinstance(before, Path)
    assert build._library_file() != before


@pytest.mark.parametrize(
    ("value", "code", "said"),
    [("python", 0, "core: Python (COSIM_CORE is python)"), ("fast", 2, "COSIM_CORE: got 'fast', wanted one of")],
)
def test_the_doctor_says_which_core_runs(value, code, said, monkeypatch, tmp_path):
    monkeypatch.setenv("COSIM_CORE", value)
    done = in_this_process(main, "doctor", cwd=tmp_path)
    assert done.returncode == code
    assert said in " ".join((done.stdout + done.stderr).split())


def test_loops_of_numpy_are_tried_before_they_are_used():
    """A loop of another function, or for another type, is noticed."""
    assert loops() is not None
    double = 12
    sine = _loop(np.sin, double)
    assert sine is not None
    assert _gives_the_same(np.sin, double, *sine)
    assert not _gives_the_same(np.cos, double, *sine)
