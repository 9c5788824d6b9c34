"""Tables as `cosim` prints them: at 80 columns, in a pipe, in every format; and the documented examples of them."""

import csv
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from cosim.commands.cli import main
from cosim.measures.statistics import Estimate
from cosim.scenes.dataset_report import NAMES, tables
from cosim.studies.realism import QUANTITIES, Distance
from cosim.studies.realism_report import _table
from cosim.studies.traffic_targets import TrafficStatistics, statistics_table
from gri.table import Table, terminal_text
from tests.command_line import in_this_process

LISTED = [
    ("results", "two"),
    ("results", "two", "--by", "policy"),
    ("results", "two", "--by", "scenario,policy,seed"),
    ("results", "two", "--runs"),
    ("results", "two", "--failures"),
    ("results", "two", "--compare", "gri,idm"),
    ("list",),
]


def assert_legible(text: str) -> None:
    for line in text.splitlines():
        assert len(line) <= 80 or ".net.xml" in line, line
    assert "…" not in text


@pytest.mark.parametrize("arguments", LISTED, ids=" ".join)
def test_no_line_is_longer_than_80_columns(short, arguments):
    done = in_this_process(main, *arguments, cwd=short)
    assert done.returncode == 0, done.stderr
    assert_legible(done.stdout)


def test_no_line_is_longer_than_80_columns_in_a_pipe(short):
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    command = [sys.executable, "-m", "cosim", "results", "two"]
    done = subprocess.run(command, cwd=short, capture_output=True, text=True, timeout=60, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout == in_this_process(main, "results", "two", cwd=short).stdout


def test_a_run_of_the_batch_is_legible_too(short):
    run = next((short / "two/runs").iterdir())
    for arguments in (("report", run.relative_to(short)), ("explain", run.relative_to(short))):
        done = in_this_process(main, *arguments, cwd=short)
        assert done.returncode == 0, done.stderr
        assert_legible(done.stdout)


def test_csv_and_json_hold_the_numbers_of_the_tables(short):
    groups = pd.read_parquet(short / "two/groups")
    rows = list(
        csv.DictReader(
            io.StringIO(in_this_process(main, "results", "two", "--by", "policy", "--format", "csv", cwd=short).stdout)
        )
    )
    for row in rows:
        if row["policy"] in ("gri", "idm"):
            mine = groups[groups["policy"] == row["policy"]]
            assert float(row["mean_speed"]) == pytest.approx(mine["mean_speed"].mean(), rel=1e-12)
    content = json.loads(in_this_process(main, "results", "two", "--runs", "--format", "json", cwd=short).stdout)
    assert {run["policy"] for run in content["runs"]} == {"gri", "idm"}
    page = in_this_process(main, "results", "two", "--by", "policy", "--format", "md", cwd=short).stdout
    table = [line for line in page.splitlines() if line.startswith("|")]
    assert len({len(re.split(r"(?<!\\)\|", line)) for line in table}) == 1


def statistics(seed: int) -> TrafficStatistics:
    return TrafficStatistics(
        seed=seed,
        mean_speed=12.3,
        speed=(10.0, 11.0, 12.0, 13.0),
        lanes=tuple((10.0 + k, 0.2) for k in range(5)),
        mainline=(7000.0, 7100.0, 7200.0),
        flow=8000.0,
        ramp_share=0.1,
        long_share=0.05,
        standing_share=0.01,
        hardest_braking=-7.5,
        waiting=12,
        collisions=0,
        teleports=0,
    )


def distances() -> Table:
    estimate = Estimate(12.34, 11.22, 13.45, 500, clusters=100)
    return _table(
        [
            Distance(part, quantity, (500, 600), (23.45, 24.56), estimate, estimate, (0.12, 0.23))
            for part in ("constant velocity", "lane 1")
            for quantity in QUANTITIES
        ]
    )


def scenes() -> list[Table]:
    scores = {"precision": dict.fromkeys(NAMES, 0.987), "recall": dict.fromkeys(NAMES, 0.456)}
    agreement = {"labels": 12345, "kappa": 0.876, **scores}
    counts = dict.fromkeys(NAMES, 123456)
    tally = {"scenes": 10000, "unambiguous": 9000, "edges": counts, "step_labels": counts}
    rejected = {"rejected": {"a vehicle is not in the corridor throughout, or changes its lane twice": 1234567}}
    found = tally | rejected | {"rule_gold": agreement, "hypothesis": agreement}
    return list(tables({"kinds": {"car_following": found, "merge": found, "triple": found}}))


def test_tables_of_slow_commands_fit_80_columns():
    """Those of cosim traffic with three seeds, cosim realism and cosim scenes, with numbers as long as they get."""
    from cosim.spec.loading import load_scenario

    scenario = load_scenario("us101_car_following")
    for table in (
        statistics_table("us101_car_following", scenario, [statistics(k) for k in range(3)]),
        distances(),
        *scenes(),
    ):
        assert_legible(terminal_text(table, 80))
        shown = re.sub(r"\s", "", terminal_text(table, 80))
        assert all(re.sub(r"\s", "", cell) in shown or " " in cell for line in table.lines for cell in line)


def test_the_example_of_the_batch_page_prints_what_the_tables_hold(short, monkeypatch, capsys):
    """The Python example of docs/batch.md, on another batch; its numbers are recomputed from the run folders."""
    page = (Path(__file__).parents[3] / "docs/batch.md").read_text()
    example = re.findall(r"```python\n(.*?)```", page, re.DOTALL)[0]
    assert "runs/batch/us101_drivers" in example
    lines = example.strip().splitlines()
    code = "\n".join([*lines[:-1], f"found = {lines[-1]}"]).replace("runs/batch/us101_drivers", "two")
    monkeypatch.chdir(short)
    names: dict[str, pd.Series] = {}
    exec(compile(code, "batch.md", "exec"), names)
    runs = {run["run"]: run for run in json.loads((short / "two/manifest.json").read_text())["runs"]}
    parts = [
        pd.read_parquet(short / "two/runs" / run / "groups.parquet").assign(of=runs[run]["policy"]) for run in runs
    ]
    expected = pd.concat(parts).groupby("of")["min_gap"].median()
    assert names["found"].to_dict() == expected.to_dict()
