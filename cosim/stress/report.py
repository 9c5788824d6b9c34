"""The report of a stress test: Markdown tables and a figure per kind of perturbation."""

from collections.abc import Collection

import numpy as np
import pandas as pd

from cosim.spec.perturbations import KINDS
from cosim.stress.estimates import CELL, COMPARED, MEASURES
from cosim.stress.plan import NOMINAL, TRAFFIC_KINDS
from gri.table import markdown_table

NOTES = """\
Each value is over the n counted starts of its row. Infeasible starts do not count, nor do interrupted ones, in which
other vehicles broke up the group; both are listed. Values are shares, medians over starts, or means (Δy, and the
follower's braking and speed loss), with 95 % intervals in brackets: Wilson's for shares, bootstrap ones otherwise.
"Contacts" lists who ran into whom by role: 0→1 means that vehicle 0 ran into vehicle 1; "other" is background traffic.
docs/stress.md describes the measures and the perturbations.
"""
PAIRED = """\
Differences from {first} on the starts that both policies drove to the end [95 % bootstrap interval]. p is that of
McNemar's exact test for shares and of the sign-flip test otherwise; it is not corrected for the number of tests.
"""


def stress_report(
    title: str,
    counts: pd.DataFrame,
    estimates: pd.DataFrame,
    differences: pd.DataFrame,
    kinds: list[str],
    figures: Collection[str] = (),
) -> str:
    """The report of a stress test as Markdown; the tables are those of `cosim.stress.estimates`.

    `kinds` are the perturbations in order; those among `figures` have a picture `figures/KIND.png` beside the report.
    Nominal rows stand in every table that has the same starts.
    """
    parts = [f"# {title}\n", NOTES]
    for kind in kinds:
        shown = [kind] if kind in TRAFFIC_KINDS else [NOMINAL, kind]
        parts += [f"## {kind}\n", _introduction(kind)]
        if kind in figures:
            parts.append(f"![Measures over the intensity of {kind}](figures/{kind}.png)\n")
        parts.append(_estimates_table(shown, counts, estimates))
        if len(differences):
            first = str(differences["against"].iloc[0])
            parts += [PAIRED.format(first=first), _differences_table(shown, differences)]
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
    head = ["intensity", "policy", "n", "infeasible", "interrupted", *titles, "contacts"]
    known = {(*_key(row), row["measure"]): (row["value"], row["low"], row["high"]) for _, row in estimates.iterrows()}
    rows = []
    for _, row in counts[counts["perturbation"].isin(kinds)].iterrows():
        values = [
            _value(known.get((*_key(row), measure.name)), 100.0 if measure.share else 1.0) for measure in MEASURES
        ]
        infeasible = f"{row['infeasible']}" + (f" ({row['why']})" if row["why"] else "")
        first = [_intensity(row), row["policy"], str(row["n"]), infeasible, str(row["interrupted"])]
        rows.append([*first, *values, row["hits"] or "-"])
    return markdown_table(head, rows)


def _key(row: pd.Series) -> tuple[str, str, str]:
    return tuple(str(row[name]) for name in CELL)  # type: ignore[return-value]


def _intensity(row: pd.Series) -> str:
    return "nominal" if np.isnan(row["intensity"]) else f"{row['intensity']:g}"


def _value(found: tuple[float, float, float] | None, scale: float) -> str:
    if found is None or np.isnan(found[0]):
        return "-"
    value, low, high = (scale * x + 0.0 for x in found)
    digits = 0 if scale == 100 else 2
    return f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def _differences_table(kinds: list[str], differences: pd.DataFrame) -> str:
    compared = [measure for measure in MEASURES if measure.name in COMPARED]
    head = ["intensity", "policy", "n", *(m.title + _unit("%" if m.share else m.unit) for m in compared)]
    part, table = differences[differences["perturbation"].isin(kinds)], []
    for _, rows in part.groupby(CELL, dropna=False, sort=False):
        row, found = rows.iloc[0], rows.set_index("measure")[["difference", "low", "high", "p"]].T.to_dict("list")
        cells = []
        for measure in compared:
            difference, low, high, p = found[measure.name]
            cells.append(f"{_value((difference, low, high), 100.0 if measure.share else 1.0)} {_p_value(p)}".strip())
        table.append([_intensity(row), row["policy"], str(row["n"]), *cells])
    return markdown_table(head, table)


def _p_value(p: float) -> str:
    return "" if np.isnan(p) else "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
