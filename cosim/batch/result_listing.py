"""Tables of the results of a batch, as `cosim results` prints them."""

import difflib
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from cosim.batch import group_statistics
from cosim.batch.group_statistics import BY_NAME, CELL, MEASURES, Measure
from cosim.batch.store import BatchStore
from cosim.measures.statistics import Estimate, PairedTest
from cosim.runs.run_reading import NEEDED, check_columns
from gri.errors import InputError
from gri.table import NBSP, Table


def select_groups(store: BatchStore, where: Sequence[str]) -> pd.DataFrame:
    """The driven groups and their counterparts that satisfy all conditions `column=value`.

    Raises `InputError` for a malformed condition, an unknown column, or if no group is left.
    """
    groups = groups_of(store)
    for condition in where:
        groups = filtered(groups, condition)
    if not len(groups):
        raise InputError(
            f"--where {' '.join(where)}: no group satisfies this; `cosim results {store.folder}` lists all"
        )
    return groups


def groups_of(store: BatchStore) -> pd.DataFrame:
    """The groups of a batch in the order of its file, with one counterpart left to SUMO per start.

    Raises `InputError` if no run has finished, if a table is damaged, or if an older version wrote the batch.
    """
    order = [run["run"] for run in store.manifest()["runs"]]
    if not store.has_table("groups"):
        raise InputError(
            f"{store.folder}: no run has finished; see the reasons with `cosim results {store.folder} --failures`"
        )
    if not store.has_table("counterparts"):
        raise InputError(
            f"{store.folder}: no table of counterparts; got a batch that an older version wrote, which mixed them into"
            " the groups; run `cosim batch` again"
        )
    tables = (_ordered(_checked(store, name, order), order) for name in ("groups", "counterparts"))
    return group_statistics.with_counterparts(*tables)


def _checked(store: BatchStore, name: str, runs: list[str]) -> pd.DataFrame:
    """The rows of a table, which has the labels of its runs."""
    rows = store.table(name, runs)
    check_columns(store.folder / name, rows, NEEDED[name])
    if missing := [label for label in CELL if label not in rows]:
        raise InputError(f"{store.folder / name}: column {missing[0]} is missing; run `cosim batch` again")
    return rows


def _ordered(rows: pd.DataFrame, runs: list[str]) -> pd.DataFrame:
    rows["run"] = pd.Categorical(rows["run"].astype(str), runs, ordered=True)
    return rows.sort_values(["run", "episode"], ignore_index=True).astype({"run": str})


def filtered(table: pd.DataFrame, condition: str) -> pd.DataFrame:
    name, equals, value = condition.partition("=")
    if not equals:
        raise InputError(f"--where {condition}: expected column=value, e.g. policy=idm")
    column = table[_column(name, table, "--where")]
    if pd.api.types.is_bool_dtype(column):
        return table[column == (value.lower() in ("true", "1", "yes"))]
    if pd.api.types.is_numeric_dtype(column):
        return table[np.isclose(column, _number(value, condition))]
    return table[column.astype(str) == value]


def _number(value: str, condition: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise InputError(f"--where {condition}: expected a number, got {value!r}") from None


def _column(name: str, table: pd.DataFrame, option: str) -> str:
    if name in table:
        return name
    close = difflib.get_close_matches(name, map(str, table.columns), n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"expected one of {', '.join(map(str, table.columns))}"
    raise InputError(f"{option}: no column {name!r}; {hint}")


def overview_table(groups: pd.DataFrame, by: str) -> Table:
    """Counts and measures with intervals, one row per combination of the comma-separated columns `by`."""
    columns = [_column(name.strip(), groups, "--by") for name in by.split(",")]
    shown = [name for name in columns if len(columns) == 1 or groups[name].nunique(dropna=False) > 1] or columns[:1]
    lines, records = [], []
    for _, row in _in_order(group_statistics.headline(groups, shown), shown).iterrows():
        labels = ["" if pd.isna(row[name]) else f"{row[name]}" for name in shown]
        counts = [group_statistics.starts_text(row["starts"], row["groups"]), row["broken_up"]]
        lines.append([*labels, *counts, *(interval(measure, row[measure.name]) for measure in MEASURES)])
        estimates = {name: value for measure in MEASURES for name, value in _record(measure, row[measure.name]).items()}
        records.append({name: row[name] for name in (*shown, "starts", "groups", "broken_up")} | estimates)
    return Table(
        "results",
        [*shown, "starts", "broken up by", *map(_title, MEASURES)],
        lines,
        records,
        note=f"95 % intervals. {group_statistics.cluster_note(groups)}",
        labels=len(shown),
    )


def _in_order(table: pd.DataFrame, columns: Sequence[str]) -> pd.DataFrame:
    """The rows ordered by the columns, and in each column by first appearance."""
    return table.sort_values(list(columns), key=lambda values: pd.Series(values.factorize(use_na_sentinel=False)[0]))


def _record(measure: Measure, estimate: Estimate) -> dict[str, float]:
    """The numbers of an estimate in the unit of the measure; shares between 0 and 1."""
    numbers = {"": estimate.value, "_low": estimate.low, "_high": estimate.high}
    if measure.most is not None:
        numbers["_most"] = estimate.most
    return {f"{measure.name}{end}": value for end, value in numbers.items()}


def _title(measure: Measure) -> str:
    return f"{measure.title} [{'%' if measure.unit == 'share' else measure.unit}]"


def interval(measure: Measure, estimate: Estimate) -> str:
    """An estimate with its upper bound, and its interval in a second line, where it has them; shares in percent."""
    if not estimate.n:
        return "-"
    factor = 100 if measure.unit == "share" else 1
    value, low, high = (factor * number for number in (estimate.value, estimate.low, estimate.high))
    shown = (
        f"{value:.1f}"
        if not estimate.most > estimate.value
        else f"{value:.1f}{NBSP}up{NBSP}to{NBSP}{factor * estimate.most:.1f}"
    )
    return shown if np.isnan(low) else f"{shown}\n({low:.1f},{NBSP}{high:.1f})"


def comparison_table(groups: pd.DataFrame, names: str) -> Table:
    """Differences between two policies, given as "a,b", on the same starts."""
    known = list(dict.fromkeys(groups["policy"]))
    chosen = [name.strip() for name in names.split(",")]
    if len(chosen) != 2 or not set(chosen) <= set(known):
        raise InputError(f"--compare {names}: expected two of {', '.join(known)}, separated by a comma")
    a, b = chosen
    pairs = group_statistics.paired_starts(groups, a, b, every_start=True)[0]
    starts = group_statistics.count_starts(pairs)
    tests = [(BY_NAME[name], test) for name, test in group_statistics.differences(groups, a, b).items()]
    return Table(
        "comparison",
        ["measure", "difference (95 % interval)", "p"],
        [
            [_title(measure), interval(measure, test.difference).replace("\n", " "), p_value(test)]
            for measure, test in tests
        ],
        [
            {"measure": measure.name, "unit": measure.unit, "difference": test.difference.value}
            | {"low": test.difference.low, "high": test.difference.high, "p": test.p}
            | {"p_corrected": test.p_corrected, "starts": starts, "groups": len(pairs)}
            for measure, test in tests
        ],
        title=f"{a} − {b} on the same starts: {group_statistics.starts_text(starts, len(pairs))}",
        note=f"{correction_note([test for _, test in tests])} {group_statistics.cluster_note(pairs)}",
    )


def p_value(test: PairedTest) -> str:
    """The uncorrected p-value, with a star if the difference is significant after the correction."""
    if np.isnan(test.p):
        return "-"
    return ("< 0.001" if test.p < 0.001 else f"{test.p:.3f}") + ("*" if test.significant else "")


def correction_note(tests: Iterable[PairedTest]) -> str:
    """What a star means, and how many tests were corrected."""
    count = sum(bool(np.isfinite(test.p)) for test in tests)
    return f"* p < 0.05 after Benjamini and Hochberg's correction for the {count} tests of this table."


def runs_table(store: BatchStore, where: Sequence[str]) -> Table:
    """Every run of the batch with its labels, its state, and its starts where it found fewer than asked for."""
    listed = pd.DataFrame(store.manifest()["runs"])
    if missing := [name for name in ("run", *CELL, "state") if name not in listed]:
        raise InputError(f"{store.folder}/manifest.json: its runs have no {missing[0]}; run `cosim batch` again")
    for condition in where:
        listed = filtered(listed, condition)
    if "starts" in listed:
        few = listed["starts"] < listed["asked"]
        told = [f"{run.state}, {run.starts:g} of {run.asked:g} starts" for run in listed[few].itertuples()]
        listed.loc[few, "state"] = told
    head = ["run", *CELL, "state"]
    lines = [["" if pd.isna(row[name]) else str(row[name]) for name in head] for _, row in listed.iterrows()]
    constant = [k for k, name in enumerate(head) if name in CELL and len({line[k] for line in lines}) == 1]
    shown = [k for k in range(len(head)) if k not in constant] if len(lines) > 1 else range(len(head))
    same = ", ".join(f"{head[k]} {lines[0][k]}" for k in constant if lines[0][k]) if len(lines) > 1 else ""
    return Table(
        "runs",
        [head[k] for k in shown],
        [[line[k] for k in shown] for line in lines],
        listed[head].to_dict("records"),
        note=f"All runs: {same}." if same else "",
        labels=len(shown),
    )


def failures_table(store: BatchStore) -> Table:
    """The reasons of all failed attempts, one row per attempt."""
    wanted: dict[str, Any] = {run["run"]: run for run in store.manifest()["runs"]}
    lines, records = [], []
    for run, failure in store.failures().items():
        if run in wanted:
            labels = " ".join(str(value) for value in failure["labels"].values() if value is not None)
            for k, attempt in enumerate(failure["attempts"]):
                lines.append([run, labels, str(k + 1), f"{attempt['kind']}: {attempt['message']}"])
                records.append({"run": run, **failure["labels"], "attempt": k + 1, **attempt})
    none = "" if lines else "No run failed."
    return Table("failures", ["run", "labels", "attempt", "reason"], lines, records, note=none, labels=4)
