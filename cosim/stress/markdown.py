"""A stress test in words: Markdown tables per perturbation."""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from cosim.spec.perturbations import KINDS
from cosim.stress.estimates import CELL, COMPARED, MEASURES
from cosim.stress.plan import NOMINAL, OF_TRAFFIC

NOTES = """\
A value is over the counted starts n of its row: infeasible starts and groups that others broke up (interrupted) are
left out and shown. Shares have Wilson 95 % intervals, medians (Δy: means) bootstrap ones. "Hits" says who ran into
whom, by roles; "other" is background traffic. Measures and perturbations: docs/stress.md.
"""
PAIRED = """\
Differences from {first} on the starts that both drove to an end [95 % bootstrap interval], with p of McNemar's exact
test (shares) or of the sign-flip test; not corrected for the number of tests.
"""


def markdown(
    title: str, counts: pd.DataFrame, estimates: pd.DataFrame, differences: pd.DataFrame, kinds: list[str]
) -> str:
    """The whole report; the nominal rows stand in every table whose starts are theirs."""
    parts = [f"# {title}\n", NOTES]
    for kind in kinds:
        shown = [kind] if kind in OF_TRAFFIC else [NOMINAL, kind]
        parts += [f"## {kind}\n", _head(kind), "\n".join(_table(shown, counts, estimates)) + "\n"]
        if len(differences):
            first = str(differences["against"].iloc[0])
            parts += [PAIRED.format(first=first), "\n".join(_paired(shown, differences)) + "\n"]
    return "\n".join(parts)


def _head(kind: str) -> str:
    spec = KINDS[kind]
    other = " Each intensity has traffic and starts of its own." if kind in OF_TRAFFIC else ""
    doc = (spec.__doc__ or "").strip().split("\n\n")[0].replace("\n    ", " ")
    return f"Intensity: {spec.symbol}{_unit(spec.unit)}. {doc}{other}\n"


def _unit(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _table(kinds: list[str], counts: pd.DataFrame, estimates: pd.DataFrame) -> Iterator[str]:
    titles = [measure.title + _unit("%" if measure.share else measure.unit) for measure in MEASURES]
    head = ["intensity", "policy", "n", "infeasible", "interrupted", *titles, "hits"]
    yield _line(head)
    yield _line(["---"] * len(head))
    known = {(*_key(row), row["measure"]): (row["value"], row["low"], row["high"]) for _, row in estimates.iterrows()}
    for _, row in counts[counts["perturbation"].isin(kinds)].iterrows():
        values = [
            _value(known.get((*_key(row), measure.name)), 100.0 if measure.share else 1.0) for measure in MEASURES
        ]
        infeasible = f"{row['infeasible']}" + (f" ({row['why']})" if row["why"] else "")
        yield _line(
            [
                _grade(row),
                row["policy"],
                str(row["n"]),
                infeasible,
                str(row["interrupted"]),
                *values,
                row["hits"] or "-",
            ]
        )


def _key(row: pd.Series) -> tuple[str, str, str]:
    return tuple(str(row[name]) for name in CELL)  # type: ignore[return-value]


def _grade(row: pd.Series) -> str:
    return "nominal" if np.isnan(row["intensity"]) else f"{row['intensity']:g}"


def _value(found: tuple[float, float, float] | None, scale: float) -> str:
    if found is None or np.isnan(found[0]):
        return "-"
    value, low, high = (scale * x + 0.0 for x in found)
    digits = 0 if scale == 100 else 2
    return f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def _paired(kinds: list[str], differences: pd.DataFrame) -> Iterator[str]:
    compared = [measure for measure in MEASURES if measure.name in COMPARED]
    head = ["intensity", "policy", "n", *(m.title + _unit("%" if m.share else m.unit) for m in compared)]
    yield _line(head)
    yield _line(["---"] * len(head))
    part = differences[differences["perturbation"].isin(kinds)]
    for _, rows in part.groupby(CELL, dropna=False, sort=False):
        row, found = rows.iloc[0], rows.set_index("measure")[["difference", "low", "high", "p"]].T.to_dict("list")
        cells = []
        for measure in compared:
            difference, low, high, p = found[measure.name]
            cells.append(f"{_value((difference, low, high), 100.0 if measure.share else 1.0)} {_p(p)}".strip())
        yield _line([_grade(row), row["policy"], str(row["n"]), *cells])


def _p(p: float) -> str:
    return "" if np.isnan(p) else "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
