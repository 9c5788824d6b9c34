"""`cosim scenes` as a person uses it, on a short scenario."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import pandas as pd
import pytest
import yaml

from cosim.spec.loading import load_scenario
from gri.data.scene_file.schema import header_of


def command(scenario: Path, out: Path, *options: object) -> list[str]:
    return [sys.executable, "-m", "cosim", "scenes", str(scenario), "--out", str(out), *map(str, options)]


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*arguments), capture_output=True, text=True, timeout=300)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def scenario(tmp_path_factory) -> Path:
    content = msgspec.to_builtins(load_scenario("us101_merge"))
    content["traffic"]["warm_up"], content["time_limit"] = 60.0, 120.0
    path = tmp_path_factory.mktemp("scenes") / "short.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.mark.slow
def test_a_data_set_is_one_file_and_a_report(scenario: Path, tmp_path: Path):
    done = run(scenario, tmp_path / "out", "--count", 6, "--per-seed", 4, "--workers", 1)
    assert done.returncode == 0, done.stderr
    table = pd.read_parquet(tmp_path / "out/scenes.parquet")
    begins = table[(table["role"] == 0) & (table["step"] == 0)]
    assert begins["kind"].value_counts().to_dict() == {"car_following": 6, "merge": 6}
    assert begins["scene"].tolist() == list(range(12))
    assert (begins.groupby("recording", observed=True)["split"].nunique() == 1).all()
    assert set(begins["source"]) == {"short"}
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "report.json",
        "scenes.parquet",
        "scenes.parquet.sha256",
    ]
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["kinds"]["merge"]["scenes"] >= 6
    assert report["cost"]["peak_mb"] > 50
    assert "Rejections" in done.stdout
    provenance = header_of(tmp_path / "out/scenes.parquet").provenance["sumo"]
    assert provenance["seeds"][0] == 1
    assert provenance["vehicle numbers"]["flows"] == {"0": "through", "1": "leaving", "2": "entering"}
    again = run(scenario, tmp_path / "out", "--count", 6)
    assert again.returncode == 2
    assert "exists already" in again.stderr


def test_mistakes_are_one_line(scenario: Path, tmp_path: Path):
    done = run(scenario, tmp_path, "--kind", "weave")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)


@pytest.mark.slow
def test_a_seed_without_a_scene_says_which_rule_turned_down_how_many(scenario: Path, tmp_path: Path):
    done = run(scenario, tmp_path, "--kind", "car_following", "--count", 1, "--per-seed", 1, "--spacing", 0.1,
               "--workers", 1)  # fmt: skip
    assert done.returncode == 2
    first = next(line for line in done.stderr.splitlines() if "seed 1: no car_following scene; turned down" in line)
    assert " too far apart" in first
    assert "too far apart" in done.stderr.splitlines()[-1]
    assert "10 seeds" in done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_workers_and_kills_do_not_show_in_the_file(scenario: Path, tmp_path: Path):
    options = "--count", 12, "--per-seed", 3
    assert run(scenario, tmp_path / "one", *options, "--workers", 1).returncode == 0
    assert run(scenario, tmp_path / "two", *options, "--workers", 2).returncode == 0
    whole = (tmp_path / "one/scenes.parquet").read_bytes()
    assert (tmp_path / "two/scenes.parquet").read_bytes() == whole
    begun = subprocess.Popen(
        command(scenario, tmp_path / "killed", *options, "--workers", 1),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    seeds, deadline = tmp_path / "killed/seeds", time.monotonic() + 120
    while not (seeds / "1").is_dir() and time.monotonic() < deadline:
        time.sleep(0.05)
    os.kill(begun.pid, signal.SIGKILL)
    begun.wait()
    assert (seeds / "0").is_dir()
    assert not (tmp_path / "killed/scenes.parquet").exists()
    assert run(scenario, tmp_path / "killed", *options, "--workers", 2).returncode == 0
    assert (tmp_path / "killed/scenes.parquet").read_bytes() == whole
