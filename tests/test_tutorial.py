"""The tutorial is what a new user types: its files are written, its commands run, in order."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

DOCS = Path(__file__).parents[1] / "docs"
TEXT = "\n".join((DOCS / page).read_text() for page in ("tutorial.md", "tutorial-batch.md"))
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
BROKEN_UP = ("cut_in", "lane_left", "lost")
INSTALLATION = ("python3 -m venv", ". .venv", "pip install")


def files() -> dict[str, str]:
    """Every block that begins with the name of a file in a comment."""
    named = [(re.match(r"(?:# |<!-- )([\w.]+\.\w+)", text), text) for kind, text in BLOCKS if kind != "bash"]
    assert all(name for name, _ in named)
    return {name[1]: text for name, text in named if name}


def commands() -> list[str]:
    lines = [line for kind, text in BLOCKS if kind == "bash" for line in text.splitlines()]
    return [line for line in lines if not line.startswith(INSTALLATION)]


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> tuple[Path, dict[str, str]]:
    """The folder in which all commands of the tutorial were run, and what each of them printed."""
    folder, printed = tmp_path_factory.mktemp("tutorial"), {}
    for name, text in files().items():
        (folder / name).write_text(text.split("\n", 1)[1] if text.startswith("<!--") else text)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    for command in commands():
        result = subprocess.run(
            shlex.split(command),
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=900,
            env=os.environ | {"PATH": path},
        )
        assert result.returncode == 0, f"{command}\n{result.stdout}\n{result.stderr}"
        printed[command] = result.stdout
    return folder, printed


def cells(text: str, label: str) -> list[str]:
    """The cells behind this label in a printed table."""
    (line,) = [line for line in text.splitlines() if line.strip(" │|").startswith(label + " ")]
    return [cell for cell in re.split(r"[│|]|\s{2,}", line.strip(" │|").removeprefix(label)) if cell.strip()]


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"[-−]?\d+(?:\.\d+)?", text.replace("−", "-"))]


def batch_groups(folder: Path, table: str) -> pd.DataFrame:
    """A table of the batch, read run by run; the labels are those of the manifest."""
    runs = json.loads((folder / "results/manifest.json").read_text())["runs"]
    labels = ["policy", "perturbation", "intensity", "seed"]
    parts = [
        pd.read_parquet(folder / "results/runs" / run["run"] / f"{table}.parquet").assign(
            **{name: np.nan if run[name] is None else run[name] for name in labels}
        )
        for run in runs
    ]
    return pd.concat(parts, ignore_index=True)


START = ["seed", "vehicle_0", "vehicle_1", "vehicle_2", "takeover_time"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "folder"),
    [
        ("cosim run us101_car_following --episodes 4 --out first", "first"),
        ("cosim run quick.yaml --out quick", "quick"),
        ("cosim run own.yaml --out own", "own"),
        ("cosim run straight.yaml --out straight", "straight"),
    ],
)
def test_the_table_of_a_run_says_what_its_tables_hold(done, command, folder):
    """Column by column: the driven groups, and the same groups left to SUMO."""
    path, printed = done
    for k, name in enumerate(("groups", "counterparts")):
        groups = pd.read_parquet(path / folder / f"{name}.parquet")
        assert set(groups["driver"] == "sumo") == {name == "counterparts"}

        def shown(label: str, k: int = k) -> list[float]:
            return numbers(cells(printed[command], label)[k])

        fine = groups["completed"] & ~groups["contact"]
        assert shown("groups") == [len(groups)]
        found = shown("completed without contact")
        assert (found[0], found[-1]) == (fine.sum(), len(groups))
        assert shown("order kept") == [groups["order_kept"].sum(), len(groups)]
        gaps = [groups["min_gap"].min(), groups["min_gap"].median()]
        assert shown("minimum gap [m]: worst / median") == pytest.approx(gaps, abs=0.051)
        assert shown("mean speed [m/s]") == pytest.approx([groups["mean_speed"].mean()], abs=0.051)


@pytest.mark.slow
def test_the_dry_run_lists_as_many_runs_as_the_text_says(done):
    _, printed = done
    count = len(printed["cosim batch batch.yaml --dry-run"].splitlines())
    said = re.search(r"lists the (\d+) runs", TEXT)
    assert said is not None
    assert f"{said[1]} runs, none started." in printed["cosim batch batch.yaml --dry-run"]
    assert count >= int(said[1])


@pytest.mark.slow
def test_the_analysis_of_the_tutorial_is_right(done):
    """`read.py` against the tables of the single runs. No group left to SUMO is among those of a policy."""
    path, printed = done
    groups, counterparts = (batch_groups(path, name) for name in ("groups", "counterparts"))
    assert set(groups["driver"]) == {"TimeGap", "idm"}, "an own policy goes by its own name"
    medians = groups.groupby(["policy", "perturbation", "intensity"], dropna=False)["min_gap"].median()
    by_sumo = counterparts.drop_duplicates(START)["min_gap"].median()
    printed_lines = printed["python read.py"].splitlines()
    lines = [line for line in printed_lines if re.search(r"\d$", line) and "dtype" not in line]
    assert [numbers(line)[-1] for line in lines] == pytest.approx([*medians, by_sumo], abs=2e-5)
    assert len(set(medians)) > 4, "the policies differ"


@pytest.mark.slow
def test_the_comparison_of_the_tutorial_is_right(done):
    """The mean difference and the number of starts, recomputed; each start was driven at two intensities."""
    path, printed = done
    text = printed["cosim results results --compare mine,idm --where perturbation=braking"]
    groups = batch_groups(path, "groups").query("perturbation == 'braking'")
    both = [groups[groups["policy"] == policy].set_index([*START, "intensity"]) for policy in ("mine", "idm")]
    mine, idm = (table.loc[both[0].index.intersection(both[1].index)] for table in both)
    whole = ~mine["ending"].isin(BROKEN_UP) & ~idm["ending"].isin(BROKEN_UP)
    difference = (mine["mean_speed"] - idm["mean_speed"])[whole].mean()
    starts = mine.reset_index()[START].drop_duplicates()
    assert f"same starts: {len(starts)} ({len(mine)} groups)" in " ".join(text.split())
    assert len(mine) > len(starts)
    assert numbers(cells(text, "mean speed [m/s]")[0])[0] == pytest.approx(difference, abs=0.051)
    tests = sum("mean" in line or "[%]" in line or "minimum" in line or "|jerk|" in line for line in text.splitlines())
    assert f"correction for the {tests} tests of this table" in " ".join(text.split())


@pytest.mark.slow
def test_the_exported_groups_are_those_of_the_tables(done):
    path, _ = done
    exported = pd.read_csv(path / "groups.csv")
    groups, counterparts = (batch_groups(path, name) for name in ("groups", "counterparts"))
    left = exported[exported["policy"] == "left to SUMO"]
    assert len(exported) - len(left) == len(groups)
    assert len(left) == len(counterparts.drop_duplicates(START))
    assert set(left["driver"]) == {"sumo"}
    for policy, rows in exported[exported["policy"] != "left to SUMO"].groupby("policy"):
        assert "sumo" not in set(rows["driver"])
        wanted = groups.loc[groups["policy"] == policy, "mean_speed"].mean()
        assert rows["mean_speed"].mean() == pytest.approx(wanted)


@pytest.mark.slow
def test_the_pages_of_the_tutorial_are_written(done):
    path, _ = done
    assert "left to SUMO" in (path / "results/report.html").read_text()
    assert (path / "first/episode-1.html").is_file()


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
