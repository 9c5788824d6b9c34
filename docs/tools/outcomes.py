"""Make the page of outcomes from stress tests: `python docs/tools/outcomes.py NAME=FOLDER[,FOLDER…] …`.

Rows of a later folder replace those of the same policy in an earlier one, so a policy can be measured again alone. A
CSV file that this script wrote does instead of a folder.
"""

import sys
from pathlib import Path

import pandas as pd

from gri.table import markdown_table

PAGE = Path(__file__).parents[1] / "results" / "outcomes"
FACTS = ("completed_without_contact", "contact", "order_kept")
POLICIES = {
    "gri": "GRI",
    "supervised": "given the graph",
    "nri": "NRI",
    "ngsim_car_following_nri": "NRI, taught recordings",
    "idm": "IDM",
    "sumo": "SUMO",
    "constant_velocity": "constant velocity",
    "gri+predict": "GRI, predicting",
    "idm+predict": "IDM, predicting",
}


def estimates_of(folders: list[Path]) -> pd.DataFrame:
    """The three facts per cell and policy; of several folders with a policy, the last one's."""
    parts = [
        pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path / "estimates.parquet") for path in folders
    ]
    found = pd.concat([part.assign(folder=k) for k, part in enumerate(parts)])
    latest = found.groupby("policy")["folder"].transform("max")
    found = found[(found["folder"] == latest) & found["measure"].isin(FACTS)]
    return found[["perturbation", "intensity", "policy", "measure", "value", "low", "high", "most", "n"]]


def table_of(estimates: pd.DataFrame) -> str:
    """One line per cell; each policy with its share completed without contact, and with a contact [%]."""
    policies = [policy for policy in POLICIES if policy in set(estimates["policy"])]
    value = estimates.set_index(["perturbation", "intensity", "policy", "measure"])["value"]
    known = estimates[["perturbation", "intensity"]].drop_duplicates().itertuples(index=False)
    cells = sorted(((str(name), float(x)) for name, x in known), key=lambda cell: (cell[0] != "nominal", *cell))
    lines = []
    for perturbation, intensity in cells:
        of_kind = value.xs(perturbation, level="perturbation")
        found = of_kind[of_kind.index.get_level_values("intensity").isin([intensity])].droplevel("intensity")
        name = perturbation if pd.isna(intensity) else f"{perturbation} {intensity:g}"
        facts = [[100 * found[policy, fact] for fact in FACTS[:2]] for policy in policies]
        lines.append([name, *(f"{done:.0f}, {contact:.0f}" for done, contact in facts)])
    return markdown_table(["perturbation", *(POLICIES[policy] for policy in policies)], lines)


def main() -> None:
    """Write one CSV and one table per scenario."""
    parts = []
    for argument in sys.argv[1:]:
        name, _, folders = argument.partition("=")
        found = estimates_of([Path(folder) for folder in folders.split(",")])
        found.to_csv(PAGE / f"{name}.csv", index=False, float_format="%.4g")
        parts.append(f"## {name}\n\n[All three facts with intervals]({name}.csv).\n\n{table_of(found)}")
    (PAGE / "tables.md").write_text("# Outcomes, 20 starts a cell: tables\n\n" + "\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
