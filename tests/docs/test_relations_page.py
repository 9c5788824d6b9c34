"""The page on the benchmark quotes what the released table holds."""

import re
from pathlib import Path

import pandas as pd

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_quotes_the_released_scores():
    table = pd.read_csv(DOCS / "results/relations/relations.csv")
    text = (DOCS / "relations.md").read_text().split("## What was found")[1].split("\n- ")[0]
    lines = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| ")
    ]
    assert len(lines) == 6
    for name, accuracy, auc, false in lines[1:]:
        row = re.sub(r" \((a constant|labels|no labels)\)$", "", name)
        part = table[table["row"] == row]
        mean = part.groupby(["kind", "score"])["value"].mean()
        assert f"{100 * mean['drivers', 'balanced_accuracy']:.0f}" == accuracy, row
        assert f"{mean['drivers', 'auc']:.2f}" == auc, row
        assert f"{100 * mean['control', 'false_follow']:.0f}" == false, row


def test_the_readme_quotes_the_released_scores():
    table = pd.read_csv(DOCS / "results/relations/relations.csv")
    part = table[(table["kind"] == "drivers") & (table["score"] == "balanced_accuracy")]
    mean = part.groupby("row")["value"].mean().mul(100).round().astype(int)
    text = " ".join((DOCS.parent / "README.md").read_text().split())
    released, constant = mean["released: us101_car_following"], mean["everybody follows the next"]
    assert released > constant + 5
    assert f"`us101_car_following` has {released} % balanced accuracy" in text
    assert f'"everybody follows the next" {constant} %' in text
    assert f"taught the relations {mean['labelled classifier (ceiling)']} %" in text
