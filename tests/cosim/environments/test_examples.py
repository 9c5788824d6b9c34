"""The examples run from beginning to end on a short road, and what they save drives in `cosim run`.

The page docs/reinforcement-learning.md runs as printed.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from cosim.environments.observation import features_of
from cosim.environments.rewards import OUTCOME_TERMS, step_terms
from cosim.runs.run import run
from cosim.spec.loading import load_scenario
from gri.core.dynamics import DUBINS, POINT_MASS_1D

ROOT = Path(__file__).parents[3]


def started(*command: object) -> str:
    """What a Python program prints."""
    done = subprocess.run([sys.executable, *map(str, command)], cwd=ROOT, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_ppo_trains_and_its_policy_drives_in_a_run(folder, tmp_path):
    pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")
    scenario, out = folder / "merge.yaml", tmp_path / "ppo"
    short = ["--scenario", scenario, "--out", out, "--starts", 4, "--parallel", 2]
    started("examples/ppo_merge.py", *short, "--steps", 1024, "--test-seeds")
    started("examples/ppo_merge.py", *short, "--steps", 2048, "--resume", "--test-seeds", 3, "--evaluate", 2)
    curve, results = pd.read_csv(out / "curve.csv"), pd.read_csv(out / "evaluation.csv", index_col="policy")
    assert curve["steps"].tolist() == [1024, 2048]
    assert curve["seconds"].is_monotonic_increasing
    assert (results["groups"] == 2).all()
    assert results.loc["constant velocity", "merged without contact"] == 0
    assert {"PPO", "PPO before training", "intelligent driver model", "left to SUMO"} < {*results.index}
    policy = {
        "kind": "python",
        "object": "cosim.environments:network_policy",
        "settings": {"file": str(out / "policy.npz")},
    }
    done = run(str(scenario), policy, episodes=2, overrides={"driven": [0]}, folder=tmp_path / "run")
    assert done.groups["driver"].tolist() == ["ppo", "ppo"]
    assert "policy_failed" not in set(done.groups["ending"])


@pytest.mark.slow
def test_scenes_are_imitated(folder, tmp_path):
    scenario, out = folder / "following.yaml", tmp_path / "imitation"
    scenes = [
        "scenes",
        scenario,
        "--kind",
        "car_following",
        "--count",
        30,
        "--per-seed",
        3,
        "--out",
        tmp_path / "scenes",
    ]
    started("-m", "cosim", *scenes)
    table = tmp_path / "scenes/scenes.parquet"
    started("examples/imitate_scenes.py", table, "--scenario", scenario, "--out", out, "--starts", 2, "--epochs", 20)
    results = json.loads((out / "evaluation.json").read_text())
    error = results.pop("squared error on test scenes")
    assert error["imitation"] < error["a constant"]
    assert set(results) == {"imitation", "intelligent driver model", "constant speed"}
    assert all(row["episodes"] == 2 for row in results.values())


@pytest.mark.slow
def test_the_page_runs_as_printed():
    text = (ROOT / "docs/reinforcement-learning.md").read_text()
    first = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)[0]
    assert re.fullmatch(r"[a-z_]+ (True|False)\n", started("-c", first))


def test_the_page_names_every_term():
    """Scenarios, reward terms and endings that the page lists are those of the code."""
    text = (ROOT / "docs/reinforcement-learning.md").read_text()
    named = set(re.findall(r"`([a-z_.]+)`", text))
    for name, role in (("us101_merge", 0), ("us101_merge", 1), ("us101_car_following", 0)):
        assert {*step_terms(load_scenario(name).group, role), *OUTCOME_TERMS} <= named
    assert len(features_of(0, DUBINS)) == 13
    assert len(features_of(0, POINT_MASS_1D)) == 8
    assert "Merges have\n13 numbers, car following has 8" in text
