"""The built wheel, used outside the source tree."""

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """A folder with the wheel's contents, and nothing of the source tree."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder / "dist"), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = (folder / "dist").glob("*.whl")
    install = [sys.executable, "-m", "pip", "install", "--no-deps", "--target", str(folder / "site"), str(wheel)]
    subprocess.run(install, check=True, capture_output=True)
    return folder / "site"


def python(installed: Path, cwd: Path, *arguments: str) -> str:
    environment = {"PYTHONPATH": str(installed), "PATH": "/usr/bin:/bin", "HOME": str(cwd)}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=cwd, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_main_job_runs_from_the_wheel(installed, tmp_path):
    where = python(installed, tmp_path, "-c", "import gri, cosim; print(gri.__file__, cosim.__file__)").split()
    assert all(Path(path).is_relative_to(installed) for path in where)
    out = python(installed, tmp_path, "-m", "cosim", "run", "us101_car_following", "--episodes", "4", "--out", "run")
    assert "Driven groups" in out
    groups = pd.read_parquet(tmp_path / "run/groups.parquet")
    assert (groups["driver"] == "gri").sum() >= 4


@pytest.mark.slow
def test_the_wheel_carries_what_names_refer_to(installed, tmp_path):
    listed = python(installed, tmp_path, "-m", "cosim", "list")
    assert all(name in listed for name in ("us101_car_following", "i80", "us101"))
    assert (installed / "gri/_bundled/sumo_nets/us101/us101.net.xml").is_file()
    assert (installed / "gri/py.typed").is_file()
    assert (installed / "cosim/py.typed").is_file()
