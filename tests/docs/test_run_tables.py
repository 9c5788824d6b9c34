"""docs/reference/run-tables.md names every column that the program writes, and no other."""

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cosim.batch.run_matrix import Cell
from cosim.perturb.effects import Effect, effects_table
from cosim.runs.run_tables import events_table, graphs_table, groups_table, steps_table
from cosim.runs.share_summary import FIGURES
from cosim.runs.surroundings_table import read_surroundings, write_surroundings
from cosim.stress.estimates import counts, differences, estimates
from cosim.world.episode import COLUMNS, Ending, Episode, EventKind
from cosim.world.groups import Group
from cosim.world.surroundings import Surroundings
from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs/reference/run-tables.md").read_text()
CHAIN = {(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW}


def named(before: str) -> list[str]:
    """The words in the first column of the first table behind this text."""
    table = re.search(r"(?:^\|.*\n)+", TEXT[TEXT.index(before) :], re.MULTILINE)
    assert table is not None
    return [word for line in table[0].splitlines()[2:] for word in re.findall(r"`(\w+)`", line.split("|")[1])]


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> dict[str, pd.DataFrame]:
    time = np.round(np.arange(0, 2.01, 0.2), 10)
    state = np.zeros((len(time), 3, len(COLUMNS)))
    state[..., COLUMNS.index("s")] = 10.0 * time[:, None] + 20.0 * np.arange(3)
    episode = Episode(
        driver="gri",
        group=Group(("a", "b", "c"), 0.4),
        time=time,
        state=state,
        valid=np.ones((len(time), 3), dtype=bool),
        driven=np.zeros((len(time), 3), dtype=bool),
        length=np.full(3, 5.0),
        width=np.full(3, 1.8),
        order=(0, 1, 2),
        graph=InteractionGraph.of_edges(CHAIN, FOLLOWING),
        graph_time=np.array([0.4]),
        ending=Ending.HORIZON,
        end=1.6,
        events=(),
        surroundings=Surroundings(("a",), np.zeros(1, int), np.ones(1), np.zeros((1, 7)), np.ones(1), np.ones(1)),
    )
    tables = {"steps": steps_table([episode]), "groups": groups_table([episode], CHAIN, [episode])}
    write_surroundings(folder := tmp_path_factory.mktemp("run"), [episode], [])
    tables["surroundings"] = read_surroundings(folder)
    return tables | {"events": events_table([episode]), "graphs": graphs_table([episode])}


@pytest.mark.parametrize("name", ["steps", "groups", "events", "graphs", "surroundings"])
def test_the_columns_of_a_run(name, run):
    assert sorted(named(f"\n## {name}\n")) == sorted(run[name].columns)


def test_endings_and_events():
    assert named("### Endings") == [ending.value for ending in Ending]
    assert named("### Kinds of events") == [kind.value for kind in EventKind]


def test_the_labels_of_a_batch():
    assert named("## Tables of a batch") == ["run", *(field.name for field in fields(Cell))]


def test_the_effects_of_perturbations():
    effect = Effect("dropout", 0.4, "share of missing states", "", 0.4, 0.4, 0.0)
    assert named("`effects.parquet`: one row") == ["policy", *effects_table([effect]).columns]


def test_the_tables_of_a_stress_test():
    rows = pd.read_parquet(ROOT / "docs/results/stress_us101_merge/episodes.parquet")
    assert sorted(named("`episodes.parquet`")) == sorted(rows.columns)
    few = rows[(rows["perturbation"] == "nominal") & rows["policy"].isin(["gri", "idm"])]
    assert named("`counts.parquet`") == list(counts(few).columns)
    assert named("`estimates.parquet`") == list(estimates(few).columns)
    assert named("`differences.parquet`") == list(differences(few).columns)


def test_the_figures_of_a_share_of_the_traffic_are_listed() -> None:
    table = TEXT[TEXT.index("`traffic.parquet`: one row for all") : TEXT.index("`vehicles.parquet`: one row")]
    listed = set(
        re.findall(r"`([\w.]+)`", "".join(line.split("|")[1] for line in table.splitlines() if line[:1] == "|"))
    )
    assert listed == {"driver", "share"} | {figure.name for figure in FIGURES}
