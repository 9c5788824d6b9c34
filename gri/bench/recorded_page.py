"""The page of results on recorded traffic."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from gri.bench.recorded_sets import STEPS

FEW = 20  # windows; with fewer, a figure says nothing


def markdown(table: pd.DataFrame) -> str:
    """Agreement, AUC against strangers, and false "follow" by control, as tables for people."""
    lanes, table = table[table["vehicles"] == "lane changes"], table[table["vehicles"] != "lane changes"]
    sites = list(dict.fromkeys(table["site"]))
    parts = [
        "# Who reacts to whom in recorded traffic: scores",
        "[How to read this, and how it is made](../../relations-recorded.md). In brackets: 95 %, clustered by following"
        f" vehicle. A dash: no windows, or fewer than {FEW}.",
        "## Recorded pairs against strangers, AUC",
        "All vehicles, cross-fitted: what is taught on recordings never saw the vehicles that it is tested on.",
        _ranking(table[table["part"] == "all"], "pairs"),
        "Test vehicles only, pairs:",
        _ranking(table[table["part"] == "test"], "pairs"),
        "Test vehicles only, triples:",
        _ranking(table[table["part"] == "test"], "triples"),
    ]
    tested = table[table["part"] == "test"]
    for site in sites:
        for vehicles in ("triples", "pairs"):
            chosen = tested[(tested["site"] == site) & (tested["vehicles"] == vehicles) & (tested["window"] == "6 s")]
            parts += [f"## {site}, {vehicles}, 6 s [%]", *_answers(chosen)]
    if len(lanes):
        cells = {
            (line["row"], line["score"]): _percent(line["value"], line["low"], line["high"])
            for line in lanes.to_dict("records")
        }
        scores = list(dict.fromkeys(lanes["score"]))
        heading = f"## Lane changes, 8 s, {lanes['windows'].max()} windows of test vehicles [%]"
        parts += [heading, _table(scores, list(dict.fromkeys(lanes["row"])), scores, cells)]
    return "\n\n".join(parts) + "\n"


def _ranking(part: pd.DataFrame, vehicles: str) -> str:
    chosen = part[(part["score"] == "auc") & (part["vehicles"] == vehicles) & (part["windows"] >= FEW)]
    columns = [(site, window) for site in dict.fromkeys(part["site"]) for window in STEPS]
    counts = chosen.groupby(["site", "window"])["windows"].max()
    columns = [key for key in columns if key in counts.index]
    heads = [f"{site}, {window} ({counts[site, window]} windows)" for site, window in columns]
    cells = {
        (line["row"], (line["site"], line["window"])): f"{line['value']:.2f} ({line['low']:.2f}–{line['high']:.2f})"
        for line in chosen.to_dict("records")
    }
    return _table(heads, list(dict.fromkeys(chosen["row"])), columns, cells)


def _answers(part: pd.DataFrame) -> list[str]:
    """Agreement and edges found in recorded windows; false "follow" in each control."""
    positive = part[(part["kind"] == "recorded") & part["score"].isin(["agreement", "found", "false_follow"])]
    control = part[(part["kind"] != "recorded") & (part["score"] == "false_follow") & (part["windows"] >= FEW)]
    between = part[(part["kind"] == "one between, in the next lane") & (part["score"] == "found")]
    between = between[between["windows"] >= FEW].assign(kind="one between: 2→0 found")
    named = {"agreement": "agreement", "found": "recorded: found", "false_follow": "recorded: false follow"}
    texts = []
    for chosen in (
        positive.assign(kind=positive["score"].map(named)),
        pd.concat([control, between]),
    ):
        columns = list(dict.fromkeys(chosen["kind"]))
        if not columns:
            continue
        counts = chosen.groupby("kind")["windows"].max()
        cells = {
            (line["row"], line["kind"]): _percent(line["value"], line["low"], line["high"])
            for line in chosen.to_dict("records")
        }
        heads = [f"{kind} ({counts[kind]})" for kind in columns]
        texts.append(_table(heads, list(dict.fromkeys(chosen["row"])), columns, cells))
    return ["In recorded windows:", texts[0], 'False "follow" in controls:', *texts[1:]] if texts else ["No windows."]


def _table(heads: Sequence[str], rows: Sequence[str], columns: Sequence, cells: dict) -> str:
    if not heads:
        return "Too few windows."
    lines = [f"| row | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    return "\n".join(
        [*lines, *(f"| {row} | {' | '.join(cells.get((row, key), '–') for key in columns)} |" for row in rows)]
    )


def _percent(value: float, low: float, high: float) -> str:
    return "–" if np.isnan(value) else f"{100 * value:.0f} ({100 * low:.0f}–{100 * high:.0f})"
