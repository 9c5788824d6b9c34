"""The Python door: `cosim.run` and what it returns."""

import json
import subprocess
import sys

import pandas as pd
import pytest

import cosim
from cosim.runs.run import _policy
from gri.core.dynamics import POINT_MASS_1D
from gri.core.policy import ConstantVelocity
from gri.errors import InputError
from tests.cosim.conftest import write_short

pytestmark = pytest.mark.usefixtures("forked_workers")


class Coasting:
    """An own policy that lets its vehicles coast: no acceleration, and no graph worth the name."""

    dynamics, dt, history_steps = POINT_MASS_1D, 0.2, 1

    def begin(self, history):
        self.coast = ConstantVelocity(self.dt, self.dynamics)
        return self.coast.begin(history)

    def act(self, memory, state):
        return self.coast.act(memory, state)


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    return write_short(tmp_path_factory.mktemp("scenario") / "short.yaml", episodes=3)


@pytest.fixture(scope="module")
def done(scenario, tmp_path_factory):
    seen = []
    run = cosim.run(
        scenario,
        "idm",
        seed=3,
        folder=tmp_path_factory.mktemp("runs") / "a < b",
        progress=lambda stage, done, total: seen.append((stage, done, total)),
    )
    return run, seen


def test_a_run_has_the_tables_of_its_folder(done):
    run, _ = done
    for name in ("steps", "groups", "counterparts", "events", "graphs"):
        pd.testing.assert_frame_equal(getattr(run, name), pd.read_parquet(run.folder / f"{name}.parquet"))
    assert set(run.groups["driver"]) == {"idm"}
    assert set(run.counterparts["driver"]) == {"sumo"}
    vehicles = ["episode", "vehicle_0", "vehicle_1", "vehicle_2", "takeover_time"]
    pd.testing.assert_frame_equal(run.counterparts[vehicles], run.groups[vehicles])
    assert (run.steps["counterpart"] == (run.steps["driver"] == "sumo")).all()
    assert run.manifest["arguments"]["seed"] == 3


def test_progress_is_told_and_ends_complete(done):
    _, seen = done
    assert ("warm-up", 300, 300) in seen
    assert ("episodes", 3, 3) in seen
    assert seen[-1] == ("picture", 1, 1)


def test_the_summary_is_the_terminals(done):
    run, _ = done
    summary = run.summary()
    assert list(summary.columns) == ["IDM", "left to SUMO"]
    assert summary.loc["groups", "IDM"] == "3"


def test_a_notebook_shows_a_short_form_in_which_names_are_data(done):
    run, _ = done
    html = run._repr_html_()
    assert "a &lt; b" in html
    assert "a < b" not in html
    assert "driver idm · seed 3 · 3 episodes" in html
    assert len(html) < 5000


def test_figures_are_drawn_of_any_episode(done):
    run, _ = done
    assert run.figure().get_suptitle().startswith("Episode ")
    assert run.figure(1).get_suptitle().startswith("Episode 1: IDM drives ")
    with pytest.raises(InputError, match=r"got 7, .* has the episodes 0 to 2"):
        run.figure(7)


def test_a_folder_that_exists_is_refused_and_left_alone(done, scenario):
    run, _ = done
    before = sorted(path.name for path in run.folder.iterdir())
    with pytest.raises(InputError, match="exists already"):
        cosim.run(scenario, "idm", folder=run.folder)
    assert sorted(path.name for path in run.folder.iterdir()) == before


def test_only_a_run_folder_can_be_opened(tmp_path):
    with pytest.raises(InputError, match="expected a run folder"):
        cosim.open_run(tmp_path)


def test_a_policy_may_be_an_object(scenario, tmp_path):
    """Also one of a class that the worker could not import, as in a notebook."""
    run = cosim.run(scenario, Coasting(), folder=tmp_path / "coasting", seed=3, episodes=1)
    coasting = run.steps.query("driver == 'Coasting' and during_drive and driven")
    assert coasting.groupby(["episode", "role"])["v"].agg(lambda v: v.max() - v.min()).max() < 1e-6
    assert json.loads((run.folder / "scenario.json").read_text())["policy"]["object"].endswith(":Coasting")
    assert run.manifest["inputs"]["policy"]["file"] == "test_run.py"
    named = cosim.run(scenario, "constant_velocity", folder=tmp_path / "named", seed=3, episodes=1)
    columns = ["s", "d", "v", "a", "gap"]
    pd.testing.assert_frame_equal(run.steps[columns], named.steps[columns])


def test_an_object_that_is_no_policy_is_refused(scenario, tmp_path):
    with pytest.raises(InputError, match="got a dict_keys without dynamics, dt"):
        cosim.run(scenario, {}.keys(), folder=tmp_path / "none")
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("idm", {"kind": "idm"}),
        ("constant-velocity", {"kind": "constant_velocity"}),
        ("us101_merge", {"kind": "gri", "checkpoint": "us101_merge"}),
        ("mine.py:Mine", {"kind": "python", "object": "mine.py:Mine"}),
        ({"kind": "sumo"}, {"kind": "sumo"}),
    ],
)
def test_policies_have_short_names(given, expected):
    assert _policy(given) == (expected, None)


def test_an_unknown_policy_says_what_there_is():
    with pytest.raises(InputError, match="got 'imd', expected one of sumo, idm, constant_velocity, r157"):
        cosim.run("us101_car_following", "imd")


def test_a_plain_script_needs_no_guard(scenario, tmp_path):
    """Without `if __name__ == "__main__":` a spawned worker must not start the script over."""
    script = tmp_path / "script.py"
    script.write_text(f"import cosim\nprint(cosim.run({str(scenario)!r}, 'idm', episodes=1, folder='out'))\n")
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout.startswith("Run('out': driver idm"), done.stderr
