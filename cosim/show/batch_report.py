"""The report of a batch: one HTML page that works without a network."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from cosim.batch import group_statistics
from cosim.batch.group_statistics import MEASURES
from cosim.batch.result_listing import correction_note, groups_of, p_value
from cosim.batch.store import BatchStore
from cosim.measures.statistics import Estimate, PairedTest, with_correction
from cosim.runs.road_view import road_view
from cosim.runs.run_reading import read_tables
from cosim.runs.summary import shortest_time
from cosim.show import graph_drawing, svg_charts
from cosim.show.animation import script_of
from cosim.show.episode_view import episode_view
from cosim.show.templates import page
from cosim.show.worst_episodes import worst_episodes
from cosim.spec.perturbations import KINDS

SHOWN_EPISODES = 6
CURVES = ("completed_without_contact", "contact", "short_ttc", "min_gap")
SPREADS = ("min_gap", "mean_speed", "min_acceleration")
AXES = ("scenario", "variant", "policy", "perturbation", "intensity")


def batch_report(store: BatchStore) -> str:
    """The HTML page of a batch, made from its tables and its manifest. Raises `InputError` if no run has finished."""
    manifest, groups = store.manifest(), groups_of(store)
    policies = list(dict.fromkeys(groups["policy"]))
    reference = policies[0]
    differences, note = _differences(groups, reference)
    return page(
        "batch.html.j2",
        title=manifest["batch"].get("description") or Path(manifest["file"]).stem,
        folder=str(store.folder),
        manifest=manifest,
        spec=_yaml(_without_defaults(manifest["batch"])),
        policies=policies,
        reference=reference,
        measures=[svg_charts.title_with_unit(measure) for measure in MEASURES],
        headline=_headline(groups),
        differences=differences,
        differences_note=note,
        cluster_note=group_statistics.cluster_note(groups),
        curves=[
            (name, svg_charts.curves(groups, name, _unit(name, manifest), CURVES)) for name in _perturbations(groups)
        ],
        spreads=svg_charts.distributions(groups, SPREADS),
        graphs=_graphs(groups),
        episodes=_episodes(store, groups),
        packed=len(store.packed()),
        failures=_failures(store, manifest),
    )


def _yaml(content: dict[str, Any]) -> str:
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100)


def _without_defaults(batch: dict[str, Any]) -> dict[str, Any]:
    """The batch without empty fields."""
    content = {name: _without_defaults(value) if isinstance(value, dict) else value for name, value in batch.items()}
    return {name: value for name, value in content.items() if value not in (None, "", [], {}, ())}


def _perturbations(groups: pd.DataFrame) -> list[str]:
    return [name for name in dict.fromkeys(groups["perturbation"]) if name != "nominal"]


def _unit(name: str, manifest: dict[str, Any]) -> str:
    """Unit of the intensity of a perturbation; "" if it has none."""
    kind = manifest["batch"]["perturbations"][name]["kind"]
    return KINDS[kind].unit if kind in KINDS else ""


def _labels(row: pd.Series, names: list[str]) -> list[str]:
    return ["" if pd.isna(row[name]) else f"{row[name]:g}" if name == "intensity" else str(row[name]) for name in names]


def _headline(groups: pd.DataFrame) -> dict[str, Any]:
    """The headline table: one row per part of the matrix."""
    order = [name for name in AXES if name != "policy" and groups[name].nunique(dropna=False) > 1] + ["policy"]
    position = {name: {str(value): k for k, value in enumerate(dict.fromkeys(groups[name]))} for name in order}
    table = [row for _, row in group_statistics.headline(groups, order).iterrows()]
    table.sort(key=lambda row: [position[name][str(row[name])] for name in order])
    return {
        "names": order,
        "rows": [
            {
                "labels": _labels(row, order),
                "counts": [group_statistics.starts_text(row["starts"], row["groups"]), row["broken_up"]],
                "figures": [_value_and_interval(row[measure.name], measure.unit) for measure in MEASURES],
            }
            for row in table
        ],
    }


def _value_and_interval(estimate: Estimate, unit: str) -> tuple[str, str]:
    """A value with its upper bound, and its 95 % interval, as text; shares in percent."""
    if not estimate.n:
        return "–", ""
    factor, digits = (100, 1) if unit == "share" else (1, 2)
    value, low, high = (f"{factor * x:.{digits}f}" for x in (estimate.value, estimate.low, estimate.high))
    if estimate.most > estimate.value:
        value += f" up to {factor * estimate.most:.{digits}f}"
    return value, "" if np.isnan(estimate.low) else f"{low} to {high}"


def _differences(groups: pd.DataFrame, reference: str) -> tuple[list[dict[str, Any]], str]:
    """Each other policy minus the reference policy on the same starts, per perturbation; and a note on the tests."""
    found, tests = [], []
    for perturbation in dict.fromkeys(groups["perturbation"]):
        part = groups[groups["perturbation"] == perturbation]
        for policy in dict.fromkeys(part["policy"]):
            if policy == reference:
                continue
            pairs = group_statistics.paired_starts(part, policy, reference, every_start=True)[0]
            if len(pairs):
                starts = group_statistics.starts_text(group_statistics.count_starts(pairs), len(pairs))
                found.append({"labels": [perturbation, f"{policy} − {reference}"], "starts": starts})
                tests += group_statistics.differences(part, policy, reference).values()
    tests = with_correction(tests)  # over the whole table
    for k, row in enumerate(found):
        own = zip(MEASURES, tests[k * len(MEASURES) : (k + 1) * len(MEASURES)], strict=True)
        row["figures"] = [(*_value_and_interval(test.difference, m.unit), _p_value(test)) for m, test in own]
    return found, correction_note(tests)


def _p_value(test: PairedTest) -> str:
    return "" if np.isnan(test.p) else f"p {p_value(test)}" if test.p < 0.001 else f"p = {p_value(test)}"


def _graphs(groups: pd.DataFrame) -> list[dict[str, Any]]:
    """Inferred graphs per scenario and policy, for policies that infer one."""
    found = []
    for (scenario, policy), part in groups.groupby(["scenario", "policy"], sort=False):
        pairs = graph_drawing.pairs_of(part)
        if pairs:
            expected = part["graph_as_expected"].dropna().astype(bool)
            found.append(
                {
                    "name": f"{policy}, {scenario}",
                    "pairs": pairs,
                    "drawing": graph_drawing.drawing(pairs),
                    "groups": len(part),
                    "expected": f"{100 * expected.mean():.0f} %",
                }
            )
    return found


def _episodes(store: BatchStore, groups: pd.DataFrame) -> list[dict[str, Any]]:
    """The worst episodes with their drives; of runs in shards, which have no folder, there are none."""
    found = []
    in_folders = groups[~groups["run"].isin(list(store.packed()))]
    for _, row in worst_episodes(in_folders, SHOWN_EPISODES).iterrows():
        folder = store.run_folder(str(row["run"]))
        tables, number = read_tables(folder), int(row["episode"])
        view = episode_view(tables, number)
        shown = {"row": row, "folder": folder, "view": view, "data": script_of(view, road_view(tables, number, folder))}
        found.append(shown | {"shortest_ttc": shortest_time(float(row["min_ttc"]))})
    return found


def _failures(store: BatchStore, manifest: dict[str, Any]) -> list[dict[str, Any]]:
    wanted = {run["run"] for run in manifest["runs"]}
    return [failure for run, failure in store.failures().items() if run in wanted]
