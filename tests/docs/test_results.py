"""Every picture stands on a page with a text alternative; tables of the stress pages are what the released rows say."""

import re
from pathlib import Path

import pandas as pd
import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
IMAGE = re.compile(r"!\[([^\]]*)\]\(([^()\s]+)\)")
STRESS = {  # kinds × (nominal and one intensity) × policies
    "stress_us101_merge": 3 * 2 * 7,
    "stress_i80_merge": 3 * 2 * 7,
    "stress_us101_merge_ended": 3 * 2 * 3,
    "stress_i80_merge_ended": 3 * 2 * 3,
}
HAND_WRITTEN = [
    path
    for path in sorted(DOCS.glob("**/*.md"))
    if not re.search(r"(yaml-fields|commands|stress|table\d|ood)\.md$", path.name) or path.parent == DOCS
]
LONG = {  # to look things up in
    "decisions/016-rooms-and-names.md",
    "reference/run-tables.md",
    "results/outcomes/tables.md",
    "results/relations/recorded.md",
    "results/relations/relations.md",
}


def images() -> list[tuple[Path, str]]:
    """Every picture of every page, with its text alternative."""
    return [
        ((page.parent / target).resolve(), text)
        for page in [ROOT / "README.md", *DOCS.glob("**/*.md"), *ROOT.glob("sumo_nets/*/*.md")]
        for text, target in IMAGE.findall(page.read_text())
    ]


def test_every_picture_is_on_a_page():
    shown = {path for path, _ in images()}
    pictures = {path for folder in (DOCS, ROOT / "sumo_nets") for path in folder.glob("**/*.png")}
    assert not sorted(str(path.relative_to(ROOT)) for path in pictures - shown)


def test_every_picture_has_a_text_alternative():
    assert not [str(path) for path, text in images() if len(text.split()) < 4]


def test_every_decision_note_is_in_the_index():
    index = (DOCS / "decisions/README.md").read_text()
    assert not [path.name for path in sorted(DOCS.glob("decisions/0*.md")) if f"({path.name})" not in index]


@pytest.mark.parametrize("page", HAND_WRITTEN, ids=lambda page: str(page.relative_to(DOCS)))
def test_pages_are_short(page):
    if str(page.relative_to(DOCS)) not in LONG:
        assert len(page.read_text().splitlines()) <= 150, "split the page, or move what was tried to docs/decisions"


@pytest.mark.parametrize("name", STRESS)
def test_every_outcome_of_a_stress_page_is_what_the_rows_say(name):
    """All cells "completed without contact", "contact" and "order kept" of stress.md, and its tables' widths."""
    folder = DOCS / f"results/{name}"
    rows = pd.read_parquet(folder / "episodes.parquet")
    rows = rows[rows["infeasible"] == ""]
    sections = re.split(r"^## ", (folder / "stress.md").read_text(), flags=re.MULTILINE)[1:]
    checked = 0
    for section in sections:
        kind = section.splitlines()[0]
        outcome = section.partition("### Outcome")[2].partition("### ")[0]
        for line in (line for line in outcome.splitlines() if line.startswith("|")):
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            assert len(cells) == 8
            if cells[0] in ("intensity", "---"):
                continue
            undisturbed = cells[0] == "nominal"
            same = rows["intensity"].isna() if undisturbed else rows["intensity"] == float(cells[0])
            part = rows[same & (rows["perturbation"] == ("nominal" if undisturbed else kind))]
            part = part[part["policy"] == cells[1]]
            facts = ("completed_without_contact", "contact", "order_kept")
            assert cells[2] == str(len(part))
            wanted = [f"{100 * part[fact].astype(bool).mean():.0f}" if len(part) else "-" for fact in facts]
            assert [cell.split()[0] for cell in cells[3:6]] == wanted, line
            checked += 1
    assert checked == STRESS[name]
