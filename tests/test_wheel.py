"""The built wheel, used outside the source tree."""

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from tests.gri.data.recordings import layout_files

ROOT = Path(__file__).parent.parent
ROUTES = """<routes>
<flow id="main" from="entry" to="downstream" end="900" vehsPerHour="6000" departLane="random" departSpeed="max"/>
<flow id="ramp" from="on_ramp" to="downstream" end="900" vehsPerHour="900"/>
</routes>"""
CONFIGURATION = '<configuration><net-file value="{net}"/><route-files value="mine.rou.xml"/></configuration>'
EPISODES = """
import gymnasium
from cosim.environments import GroupEnv

scenario = {"scenario": "mine.yaml", "sees": "everybody", "overrides": {"episodes": 1}}
env = gymnasium.make("cosim/scenario-v1", **scenario)
observation, info = env.reset(seed=1)
after, reward, *_ = env.step(env.action_space.sample())
assert env.observation_space.contains(after), after
env.close()
group = GroupEnv(**scenario)
observations, infos = group.reset(seed=1)
observations, rewards, *_ = group.step({name: group.action_space(name).sample() for name in group.agents})
group.close()
assert infos["vehicle_0"]["group"] == info["group"]
print(*sorted(rewards))
"""


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


@pytest.mark.slow
def test_a_scenario_of_ones_own_runs_learns_and_is_exported(installed, tmp_path):
    """From a SUMO configuration to a proposed scenario, a run, an exported episode and both kinds of environments."""
    (tmp_path / "mine.rou.xml").write_text(ROUTES)
    net = installed / "gri/_bundled/sumo_nets/us101/us101.net.xml"
    (tmp_path / "mine.sumocfg").write_text(CONFIGURATION.format(net=net))
    new = ("-m", "cosim", "new", "mine.sumocfg", "--rule", "car_following", "--seconds", "60")
    assert "car following:" in python(installed, tmp_path, *new)
    assert "ok      road: entry" in python(installed, tmp_path, "-m", "cosim", "check", "mine.yaml")
    python(installed, tmp_path, "-m", "cosim", "run", "mine.yaml", "--episodes", "1", "--out", "run")
    python(installed, tmp_path, "-m", "cosim", "export", "run", "--out", "episode.xml")
    group = pd.read_parquet(tmp_path / "run/groups.parquet").iloc[0]
    assert f'id="{group["vehicle_0"]}"' in (tmp_path / "episode.xml").read_text()
    assert python(installed, tmp_path, "-c", EPISODES).split() == ["vehicle_0", "vehicle_1"]


@pytest.mark.slow
def test_recordings_are_read_and_cut(installed, tmp_path):
    layout_files.highd(layout_files.traffic(), tmp_path / "data")
    gri = str(installed / "bin/gri")
    assert "layout: highd" in python(installed, tmp_path, gri, "scenes", "inspect", "data/07_tracks.csv")
    make = ("scenes", "make", "data/07_tracks.csv", "--split", "all-test", "--out", "scenes.parquet")
    assert "scenes in scenes.parquet" in python(installed, tmp_path, gri, *make)
