"""The README's promises."""

import inspect
import re
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

import cosim
from cosim.stress.merge_outcomes import merge_table
from cosim.world.episode import COLUMNS

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
RESULTS = ROOT / "docs/results"
ROWS = {
    cells[0]: cells[1:]
    for cells in ([c.strip() for c in line.split("|")[1:-1]] for line in README.splitlines() if line.startswith("| "))
}

MERGES = {
    "undisturbed": ("nominal", None),
    "starts abreast of the leader": ("headway_ratio", 1.0),
    "leader brakes at 8 m/s²": ("leader_braking", 8.0),
    "others are seen 0.4 s late": ("perception_latency", 0.4),
}
MERGE_POLICIES = ["gri", "gri+rss", "supervised", "nri", "idm", "sumo", "constant_velocity"]


def test_python_examples_run(monkeypatch):
    """With a stand-in for the run itself; tests/cosim/runs/test_run.py runs one."""
    row = {"driver": "idm", "driven": True, "role": 0, "jerk": 0.1} | dict.fromkeys(COLUMNS, 0.0)
    signature = inspect.signature(cosim.run)

    def run(*arguments, **options):
        signature.bind(*arguments, **options)
        return SimpleNamespace(steps=pd.DataFrame([row, row]))

    monkeypatch.setattr(cosim, "run", run)
    examples = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert examples
    for example in examples:
        exec(compile(example, "README.md", "exec"), {})


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert target.startswith("https://") or (ROOT / target).exists(), target


def test_the_gate_installs_as_the_readme_says():
    gate = (ROOT / ".ci/run").read_text()
    assert "pip install -c .ci/constraints.txt -e '.[test]'" in README
    assert "-c .ci/constraints.txt -e '.[test]'" in gate


def test_the_merge_table_is_what_the_released_episodes_say():
    folders = {"US-101": "stress_us101_merge", "I-80": "stress_i80_merge"}
    sites = {site: pd.read_parquet(RESULTS / folder / "episodes.parquet") for site, folder in folders.items()}
    assert merge_table(sites, MERGES, MERGE_POLICIES) in README
    for site, folder in folders.items():
        assert merge_table({site: sites[site]}, MERGES, MERGE_POLICIES) in (RESULTS / folder / "README.md").read_text()


def test_what_the_options_of_merges_are_worth_is_what_the_released_episodes_say():
    page = (ROOT / "docs/groups-that-change.md").read_text()
    for ending in ("", "_ended"):
        folders = {"US-101": f"stress_us101_merge{ending}", "I-80": f"stress_i80_merge{ending}"}
        sites = {site: pd.read_parquet(RESULTS / folder / "episodes.parquet") for site, folder in folders.items()}
        assert merge_table(sites, MERGES, ["gri", "gri+rss", "idm"]) in page


def mean(table: pd.DataFrame, row: str, metric: str) -> float:
    """Mean over the seeds that a released table has of a row."""
    return float(table.loc[(table["row"] == row) & (table["metric"] == metric), "mean"].mean())


@pytest.mark.parametrize("scenario", ["car_following", "lane_changing"])
def test_synthetic_figures_are_those_of_the_released_tables(scenario):
    table = pd.read_parquet(RESULTS / scenario / "table1.parquet")
    areas = pd.read_parquet(RESULTS / scenario / "ood_areas.parquet").query("front == 'constant_speed'")
    name = scenario.replace("_", " ")
    policies = ("GRI", "Supervised", "NRI")
    least = areas.groupby("row")["share_of_oracle"].min()
    cells = pd.read_parquet(RESULTS / scenario / "ood.parquet").query("front == 'constant_speed'")
    worst = 100 * cells.groupby(["row", "seed"])["collision"].mean().groupby("row").max()
    printed = [
        f"{1000 * mean(table, policy, 'rmse_x'):.1f}; {least[policy]:.3f}, {worst[policy]:.0f} %" for policy in policies
    ]
    assert ROWS[f"synthetic {name}: RMSE_x [mm]; success, collisions out of distribution"][:3] == printed
    if scenario == "car_following":
        assert f"the optimal driver has {worst['oracle']:.0f} % as well" in " ".join(README.split())
    grounded, untrained, others = ROWS[f"synthetic {name}, one graph for all"]
    assert grounded == f"{100 * mean(table, 'GRI', 'accuracy'):.0f} %"
    empty = 100 * table.loc[table["metric"] == "empty_graph_accuracy", "mean"].mean()
    assert f"empty graph {empty:.1f} %" in untrained
    assert others == f"NRI {100 * mean(table, 'NRI', 'accuracy_renamed'):.1f} %"
    differing = pd.read_parquet(RESULTS / f"{scenario}_mixed" / "table1.parquet")
    seeds = 100 * differing.query("row == 'GRI' and metric == 'accuracy'")["mean"]
    empty = 100 * differing.query("metric == 'empty_graph_accuracy'")["mean"].iloc[0]
    assert ROWS[f"synthetic {name}, graphs differ"][:2] == [
        f"{seeds.min():.2f} to {seeds.max():.2f} %",
        f"empty graph {empty:.1f} %",
    ]


def test_recorded_figures_are_those_of_the_released_tables():
    following = pd.read_csv(RESULTS / "ngsim/car_following/table2.csv").query("trained_on == 'both'")
    changing = pd.read_csv(RESULTS / "ngsim/lane_changing/table2.csv").query("stage == 'drawn only'")
    rows = ("GRI", "Supervised", "NRI", "IDM, calibrated")
    errors = [f"{mean(following, row, 'rmse_x'):.2f}" for row in rows]
    assert ROWS["NGSIM car following: RMSE_x over 5.8 s [m]"] == errors
    pairs = [f"{mean(changing, row, 'rmse_x'):.2f}, {mean(changing, row, 'rmse_y'):.2f}" for row in rows[:3]]
    assert ROWS["NGSIM lane changing: RMSE_x, RMSE_y over 7.8 s [m]"][:3] == pairs
    assert ROWS["NGSIM car following"][0] == f"{100 * mean(following, 'GRI', 'accuracy'):.0f} %"
    assert ROWS["NGSIM lane changing"][0] == f"{100 * mean(changing, 'GRI', 'accuracy'):.1f} %"
    assert f"NRI {100 * mean(changing, 'NRI', 'accuracy_renamed'):.0f} %" in ROWS["NGSIM lane changing"][2]
    assert f"NRI {100 * mean(following, 'NRI', 'accuracy'):.0f} %" in ROWS["NGSIM car following"][2]


def test_contacts_stand_beside_success_out_of_distribution():
    cells = pd.read_parquet(RESULTS / "lane_changing/ood.parquet")
    ahead = cells.query("row == 'GRI' and front == 'policy' and headway == -8")[["success", "collision"]].mean()
    assert (
        f"in {100 * ahead['success']:.0f} % and comes closer than 2 m in {100 * ahead['collision']:.0f} %"
        in " ".join(README.split())
    )
