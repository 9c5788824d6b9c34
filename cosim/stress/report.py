"""The report of a stress test: Markdown tables and a figure per kind of perturbation."""

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from cosim.batch.group_statistics import Measure
from cosim.perturb.effects import KEY, pooled, shown_effects
from cosim.spec.perturbations import KINDS
from cosim.stress.estimates import CELL, MEASURES, TIME_CAP
from cosim.stress.plan import NOMINAL, TRAFFIC_KINDS
from cosim.stress.preventable import preventable_text
from gri.table import markdown_table

SHOWN = ("min_ttc", "max_drac", "min_gap", "jerk_95", "follower_braking")
PAIRED_SHOWN = ("completed_without_contact", "contact", "min_ttc", "min_gap", "jerk_95")
CAPS = {name: TIME_CAP for name in ("min_ttc", "min_pet", "min_headway")}  # larger values are told as "> 30"
Known = dict[tuple[str, str, str, str], tuple[float, ...]]
"""(perturbation, intensity, policy, measure) -> value, ends of its interval, upper bound."""
_BY_NAME = {measure.name: measure for measure in MEASURES}

NOTES = """\
The outcome is over all feasible starts. "Up to" counts groups as completed that broke up by no known fault of the
policy. The other measures are over the n starts whose group did not break up: shares, medians over starts, or means
(the follower's braking). Brackets hold 95 % intervals. {clusters}
"Contacts" lists which vehicle drove into which by role: 0→1 means that vehicle 0 drove into vehicle 1; "other" is
background traffic. They count until 10 s after the hand-back.
[estimates.csv](estimates.csv) has all measures, [differences.csv](differences.csv) all tests, [counts.csv](counts.csv)
all counts. docs/stress.md describes the measures and the perturbations.
"""
OUTCOME_HEADING = "### Outcome\n"
FILTER_HEADING = "### Safety filter\n"
SAFETY_HEADING = "### Safety and comfort\n"
PAIRED = """\
### Differences

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
    remarks: Sequence[str] = (),
    effects: pd.DataFrame | None = None,
    preventable: pd.DataFrame | None = None,
) -> str:
    """The report of a stress test as Markdown; the tables are those of `cosim.stress.estimates`.

    `kinds` are the perturbations in order, `figures` the names of the pictures in `figures/` (`cosim.stress.figures`).
    Nominal rows stand in every table that has the same starts. `clusters` says what intervals and tests take as
    independent, `remarks` are sentences that stand before everything else, such as the result of a sequential test.
    """
    parts = [f"# {title}\n", *(f"**{text}**\n" for text in remarks if text), NOTES.format(clusters=clusters)]
    known: Known = {
        (*_key(row), str(row["measure"])): tuple(row[["value", "low", "high", "most"]])
        for _, row in estimates.iterrows()
    }
    for kind in kinds:
        shown = [kind] if kind in TRAFFIC_KINDS else [NOMINAL, kind]
        parts += [f"## {kind}\n", _introduction(kind)]
        if effects is not None and (effects["perturbation"] == kind).any():
            reached = pooled(effects[effects["perturbation"] == kind], KEY)
            table = shown_effects(reached)
            parts.append(
                f"{table.title}, in the mean over groups and policies:\n\n{markdown_table(table.head, table.lines)}"
            )
        parts += [f"![{_alternative(kind)}](figures/{name}.png)\n" for name in _figures_of(kind, figures)]
        cells = counts[counts["perturbation"].isin(shown)]
        parts += [*filter(None, [_infeasible(cells)]), OUTCOME_HEADING, _outcome_table(cells, known)]
        if len(filtered := cells[cells["filter"].ne("")]):
            parts += [FILTER_HEADING, _filter_table(filtered)]
        parts += [] if preventable is None else [*filter(None, [preventable_text(preventable, shown)])]
        parts += [SAFETY_HEADING, _safety_table(cells, known)]
        if len(differences):
            first = str(differences["against"].iloc[0])
            tests = int(differences["p"].notna().sum())
            parts += [PAIRED.format(first=first, tests=tests), _differences_table(shown, differences)]
    return "\n".join(parts)


def _figures_of(kind: str, figures: Collection[str]) -> list[str]:
    """The pictures of a kind: KIND, and KIND-2 and so on where there are many policies."""
    return sorted(name for name in figures if re.fullmatch(rf"{kind}(-\d+)?", name))


def _alternative(kind: str) -> str:
    return f"Six measures over the intensity of {kind.replace('_', ' ')}, one curve per policy; numbers in the tables"


def _introduction(kind: str) -> str:
    spec = KINDS[kind]
    other = " Each intensity has its own traffic and starts." if kind in TRAFFIC_KINDS else ""
    doc = (spec.__doc__ or "").strip().split("\n\n")[0].replace("\n    ", " ")
    return f"Intensity: {spec.symbol}{_unit(spec.unit)}. {doc}{other}\n"


def _unit(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _outcome_table(rows: pd.DataFrame, known: Known) -> str:
    """The three facts over all feasible starts, who broke up groups, and who ran into whom."""
    facts = [_BY_NAME[name] for name in ("completed_without_contact", "contact", "order_kept")]
    head = ["intensity", "policy", "starts", *map(_title, facts), "broken up by", "contacts"]
    lines = [
        [
            *(_intensity(row), row["policy"], str(row["starts"] - row["infeasible"])),
            *(_value(known.get((*_key(row), fact.name)), fact) for fact in facts),
            *(row["broken_up"] or "-", row["hits"] or "-"),
        ]
        for _, row in rows.iterrows()
    ]
    return markdown_table(head, lines)


def _filter_table(rows: pd.DataFrame) -> str:
    """How often and how hard the safety filter intervened."""
    lines = [[_intensity(row), row["policy"], *row["filter"].split(", ")] for _, row in rows.iterrows()]
    return markdown_table(
        ["intensity", "policy", "steps with less acceleration", "steps with less steering", "hardest braking"], lines
    )


def _safety_table(rows: pd.DataFrame, known: Known) -> str:
    """Safety and comfort over the starts whose group did not break up."""
    measures = [_BY_NAME[name] for name in SHOWN]
    head = ["intensity", "policy", "n", *map(_title, measures)]
    lines = [
        [
            *(_intensity(row), row["policy"], str(row["n"])),
            *(_value(known.get((*_key(row), measure.name)), measure) for measure in measures),
        ]
        for _, row in rows.iterrows()
    ]
    return markdown_table(head, lines)


def _infeasible(rows: pd.DataFrame) -> str:
    """The infeasible starts by intensity and reason; they are the same for all policies."""
    found = {_intensity(row): row["why"] for _, row in rows.iterrows() if row["why"]}
    return f"Infeasible starts: {'; '.join(f'{why} at {at}' for at, why in found.items())}.\n" if found else ""


def _title(measure: Measure) -> str:
    return measure.title + _unit("%" if measure.share else measure.unit)


def _key(row: pd.Series) -> tuple[str, str, str]:
    return tuple(str(row[name]) for name in CELL)  # type: ignore[return-value]


def _intensity(row: pd.Series) -> str:
    return "nominal" if np.isnan(row["intensity"]) else f"{row['intensity']:g}"


def _value(found: tuple[float, ...] | None, measure: Measure) -> str:
    """A value, its upper bound if there is one above it, and its interval if there is one."""
    if found is None or np.isnan(found[0]):
        return "-"
    scale, digits = (100.0, 0) if measure.share else (1.0, 2)
    value, low, high, most = (scale * x + 0.0 for x in found)
    up_to = f" up to {most:.{digits}f}" if most > value else ""
    cap = CAPS.get(measure.name, np.inf)
    shown = [f"> {cap:g}" if number >= cap else f"{number:.{digits}f}" for number in (value, low, high)]
    return f"{shown[0]}{up_to}" + ("" if np.isnan(low) else f" [{shown[1]}, {shown[2]}]")


def _differences_table(kinds: list[str], differences: pd.DataFrame) -> str:
    compared = [_BY_NAME[name] for name in PAIRED_SHOWN]
    head = ["intensity", "policy", "starts", *map(_title, compared)]
    part, table = differences[differences["perturbation"].isin(kinds)], []
    for _, rows in part.groupby(CELL, dropna=False, sort=False):
        row, found = rows.iloc[0], rows.set_index("measure").to_dict("index")
        cells = []
        for measure in compared:
            test = found[measure.name]
            p = _p_value(test["p"]) + ("*" if test["p_corrected"] < 0.05 else "")
            cells.append(f"{_difference(test, 100.0 if measure.share else 1.0)} {p}".strip())
        table.append([_intensity(row), row["policy"], str(row["n"]), *cells])
    return markdown_table(head, table)


def _difference(test: Mapping[Any, Any], scale: float) -> str:
    if np.isnan(test["difference"]):
        return "-"
    digits = 0 if scale == 100 else 2
    value, low, high = (f"{scale * test[name] + 0.0:.{digits}f}" for name in ("difference", "low", "high"))
    return value if np.isnan(test["low"]) else f"{value} [{low}, {high}]"


def _p_value(p: float) -> str:
    return "" if np.isnan(p) else "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
