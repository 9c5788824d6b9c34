"""The report of a stress test: Markdown tables and a figure per kind of perturbation."""

from collections.abc import Collection

import numpy as np
import pandas as pd

from cosim.spec.perturbations import KINDS
from cosim.stress.estimates import CELL, COMPARED, MEASURES
from cosim.stress.plan import NOMINAL, TRAFFIC_KINDS
from gri.table import markdown_table

NOTES = """\
The outcome (completed without contact, contact, completed, order kept) is over all feasible starts. "Up to" counts
groups as completed that broke up by no known fault of the policy. All other measures are over the n starts whose group
did not break up. Values are shares, medians over starts, or means (Δy, and the follower's braking and speed loss), with
95 % intervals in brackets. {clusters}
"Contacts" lists which vehicle drove into which by role: 0→1 means that vehicle 0 drove into vehicle 1; "other" is
background traffic. They count until 10 s after the hand-back.
docs/stress.md describes the measures and the perturbations.
"""
PAIRED = """\
Differences from {first} on the same starts [95 % interval], with the p of a sign-flip test. A star marks p < 0.05 after
Benjamini and Hochberg's correction for the {tests} tests of this report. For the outcome, groups that broke up count as
not completed.
"""


def stress_report(
    title: str,
    counts: pd.DataFrame,
    estimates: pd.DataFrame,
    differences: pd.DataFrame,
    kinds: list[str],
    figures: Collection[str] = (),
    clusters: str = "",
    decided: str = "",
) -> str:
    """The report of a stress test as Markdown; the tables are those of `cosim.stress.estimates`.

    `kinds` are the perturbations in order; those among `figures` have a picture `figures/KIND.png` beside the report.
    Nominal rows stand in every table that has the same starts. `clusters` says what intervals and tests take as
    independent, `decided` is the result of a sequential test.
    """
    parts = [f"# {title}\n", *([f"**{decided}**\n"] if decided else []), NOTES.format(clusters=clusters)]
    for kind in kinds:
        shown = [kind] if kind in TRAFFIC_KINDS else [NOMINAL, kind]
        parts += [f"## {kind}\n", _introduction(kind)]
        if kind in figures:
            parts.append(f"![Measures over the intensity of {kind}](figures/{kind}.png)\n")
        parts.append(_estimates_table(shown, counts, estimates))
        if len(differences):
            first = str(differences["against"].iloc[0])
            tests = int(differences["p"].notna().sum())
            parts += [PAIRED.format(first=first, tests=tests), _differences_table(shown, differences)]
    return "\n".join(parts)


def _introduction(kind: str) -> str:
    spec = KINDS[kind]
    other = " Each intensity has its own traffic and starts." if kind in TRAFFIC_KINDS else ""
    doc = (spec.__doc__ or "").strip().split("\n\n")[0].replace("\n    ", " ")
    return f"Intensity: {spec.symbol}{_unit(spec.unit)}. {doc}{other}\n"


def _unit(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _estimates_table(kinds: list[str], counts: pd.DataFrame, estimates: pd.DataFrame) -> str:
    titles = [measure.title + _unit("%" if measure.share else measure.unit) for measure in MEASURES]
    head = ["intensity", "policy", "n", "infeasible", "broken up by", *titles, "contacts"]
    shown = ["value", "low", "high", "most"]
    known = {(*_key(row), row["measure"]): tuple(row[shown]) for _, row in estimates.iterrows()}
    rows = []
    for _, row in counts[counts["perturbation"].isin(kinds)].iterrows():
        values = [
            _value(known.get((*_key(row), measure.name)), 100.0 if measure.share else 1.0) for measure in MEASURES
        ]
        infeasible = f"{row['infeasible']}" + (f" ({row['why']})" if row["why"] else "")
        first = [_intensity(row), row["policy"], str(row["n"]), infeasible, row["broken_up"]]
        rows.append([*first, *values, row["hits"] or "-"])
    return markdown_table(head, rows)


def _key(row: pd.Series) -> tuple[str, str, str]:
    return tuple(str(row[name]) for name in CELL)  # type: ignore[return-value]


def _intensity(row: pd.Series) -> str:
    return "nominal" if np.isnan(row["intensity"]) else f"{row['intensity']:g}"


def _value(found: tuple[float, ...] | None, scale: float) -> str:
    """A value, its upper bound if there is one above it, and its interval if there is one."""
    if found is None or np.isnan(found[0]):
        return "-"
    value, low, high, most = (scale * x + 0.0 for x in found)
    digits = 0 if scale == 100 else 2
    up_to = f" up to {most:.{digits}f}" if most > value else ""
    return f"{value:.{digits}f}{up_to}" + ("" if np.isnan(low) else f" [{low:.{digits}f}, {high:.{digits}f}]")


def _differences_table(kinds: list[str], differences: pd.DataFrame) -> str:
    compared = [measure for measure in MEASURES if measure.name in COMPARED]
    head = ["intensity", "policy", "n", *(m.title + _unit("%" if m.share else m.unit) for m in compared)]
    part, table = differences[differences["perturbation"].isin(kinds)], []
    for _, rows in part.groupby(CELL, dropna=False, sort=False):
        row, found = rows.iloc[0], rows.set_index("measure").to_dict("index")
        cells = []
        for measure in compared:
            test = found[measure.name]
            numbers = (test["difference"], test["low"], test["high"], np.nan)
            p = _p_value(test["p"]) + ("*" if test["p_corrected"] < 0.05 else "")
            cells.append(f"{_value(numbers, 100.0 if measure.share else 1.0)} {p}".strip())
        table.append([_intensity(row), row["policy"], str(row["n"]), *cells])
    return markdown_table(head, table)


def _p_value(p: float) -> str:
    return "" if np.isnan(p) else "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
