"""A batch of short, real runs, and the command as a person uses it."""

import subprocess
import sys
from pathlib import Path

import pytest

SHORT = """\
scenarios: [us101_car_following]
policies:
  gri: {kind: gri, checkpoint: us101_car_following}
  idm: {kind: idm}
seeds: [1, 2]
overrides:
  traffic: {warm_up: 30}
  horizon: 2.0
  watch: 1.0
  rest: 0.2
  episodes: 2
  time_limit: 60
"""


def cosim(*arguments: object, cwd: Path, timeout: float = 300) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "cosim", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=timeout)


def tables(folder: Path) -> dict[str, bytes]:
    """The content of every table of every finished run, by name."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.glob("runs/*/*.parquet"))}


@pytest.fixture(scope="session")
def short(tmp_path_factory) -> Path:
    """A folder with a batch file and, in `two`, its results from two workers."""
    folder = tmp_path_factory.mktemp("batch")
    (folder / "short.yaml").write_text(SHORT)
    done = cosim("batch", "short.yaml", "--workers", 2, "--out", "two", cwd=folder)
    assert done.returncode == 0, done.stderr
    (folder / "said").write_text(done.stdout + done.stderr)
    return folder
