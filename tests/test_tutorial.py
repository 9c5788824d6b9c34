"""The tutorial is what a new user types: its files are written, its commands run, in order."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
TEXT = "\n".join((DOCS / page).read_text() for page in ("tutorial.md", "tutorial-batch.md"))
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
INSTALLATION = ("python3 -m venv", ". .venv", "pip install")


def files() -> dict[str, str]:
    """Every block that begins with the name of a file in a comment."""
    named = [(re.match(r"(?:# |<!-- )([\w.]+\.\w+)", text), text) for kind, text in BLOCKS if kind != "bash"]
    assert all(name for name, _ in named)
    return {name[1]: text for name, text in named if name}


def commands() -> list[str]:
    lines = [line for kind, text in BLOCKS if kind == "bash" for line in text.splitlines()]
    return [line for line in lines if not line.startswith(INSTALLATION)]


@pytest.mark.slow
def test_every_command_of_the_tutorial_works(tmp_path):
    for name, text in files().items():
        (tmp_path / name).write_text(text.split("\n", 1)[1] if text.startswith("<!--") else text)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    printed = {}
    for command in commands():
        done = subprocess.run(
            shlex.split(command),
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=900,
            env=os.environ | {"PATH": path},
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        printed[command] = done.stdout
    medians = re.findall(r" ([\d.]+)$", printed["python read.py"], re.MULTILINE)
    assert len(medians) == 8
    assert len(set(medians)) > 4, "the policies differ: counterparts left to SUMO are not among them"
    assert (tmp_path / "results/report.html").is_file()
    assert (tmp_path / "first/episode-1.html").is_file()


def test_every_command_of_the_tools_is_known():
    from typer.main import get_command

    from cosim.commands.cli import app

    known = set(get_command(app).commands)  # type: ignore[attr-defined]
    used = {line.split()[1] for line in commands() if line.startswith("cosim ")}
    assert used <= known
    assert {"run", "traffic", "batch", "results", "report", "explain", "render"} <= used


@pytest.mark.parametrize("name", [name for name in files() if name.endswith(".yaml")])
def test_every_file_of_the_tutorial_is_valid(name, tmp_path, monkeypatch):
    """Quickly, without running anything; the batch finds its scenario and its policy beside it."""
    from cosim.batch.run_matrix import expand, load_batch
    from cosim.spec.loading import load_scenario

    monkeypatch.chdir(tmp_path)
    for other, text in files().items():
        (tmp_path / other).write_text(text)
    (tmp_path / "straight.net.xml").write_text("<net/>")
    if name == "batch.yaml":
        assert len(expand(*load_batch(name))) == 3 * 3 * 2 - 2
    else:
        assert load_scenario(name)
