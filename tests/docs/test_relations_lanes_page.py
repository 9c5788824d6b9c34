"""The page on the lane benchmark quotes what the released table holds."""

import re
from pathlib import Path

import pandas as pd

DOCS = Path(__file__).parents[2] / "docs"
SCORES = ("macro_f1", "accuracy", "scene_accuracy")


def test_the_page_quotes_the_released_scores():
    table = pd.read_csv(DOCS / "results/relations/lanes.csv")
    text = (DOCS / "relations-lanes.md").read_text().split("## What was found")[1].split("\n- ")[0]
    lines = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| ")
    ]
    assert len(lines) == 10
    for name, *cells in lines[1:]:
        row = re.sub(r" \((a constant|labels.*|no labels)\)$", "", name)
        mean = table[table["row"] == row].groupby(["kind", "score"])["value"].mean()
        values = [f"{100 * mean['drivers', score]:.0f}" for score in SCORES]
        assert [*values, f"{100 * mean['control', 'false_relation']:.0f}"] == cells, row


def test_no_constant_has_more_than_sixty_percent():
    table = pd.read_csv(DOCS / "results/relations/lanes.csv")
    constants = table[table["row"].isin(["nobody reacts", "most frequent per pair"])]
    assert (constants.loc[constants["score"] == "accuracy", "value"] < 0.6).all()
