"""`gri bench relations --recordings`: who reacts to whom in recorded traffic? Scores every row, with intervals.

One job is a row, a window length and a seed. A finished job is a file, see `gri.bench.resumable_jobs`.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

from gri.bench.answers import Infer, ask
from gri.bench.car_following_scenes import KnownScenes
from gri.bench.recorded_lane_changes import lane_change_scores
from gri.bench.recorded_page import markdown
from gri.bench.recorded_rows import RECORDED_ROWS, TAUGHT_KINDS, UPDATES, RecordedRow
from gri.bench.recorded_scores import ranking, share
from gri.bench.recorded_sets import (
    COPIES,
    CROSSED_KINDS,
    CROSSED_VEHICLES,
    FOLDS,
    STEPS,
    STRIDE,
    RecordedSet,
    Recordings,
)
from gri.bench.resumable_jobs import check_names, finish, job_file, kept
from gri.bench.scores import Score
from gri.core.edges import pairs
from gri.data.ngsim.following_triples import read_sites
from gri.progress import Progress, no_progress
from gri.storage.whole_files import write_whole

VERSION = 1  # of the windows and rows; another one makes all jobs again
KEYS = ["row", "given", "part", "site", "window", "vehicles", "kind", "score"]


@dataclass(frozen=True)
class RecordedPlan:
    """What to score, and where results go."""

    out: Path
    files: tuple[Path, ...]
    seeds: int = 1
    rows: tuple[str, ...] = ()
    """Only rows of these names; () for all."""
    windows: tuple[str, ...] = tuple(STEPS)
    lanes: bool = True
    """Whether lane changes are scored as well, all rows of them."""

    def jobs(self) -> list[tuple[RecordedRow, str, int]]:
        """Rows, window lengths and seeds; rows that do not depend on the seed are done once."""
        check_names(self.rows, [row.name for row in RECORDED_ROWS])
        wanted = [row for row in RECORDED_ROWS if not self.rows or row.name in self.rows]
        return [
            (row, window, seed)
            for row in wanted
            for window in self.windows
            for seed in range(self.seeds if row.varies else 1)
        ]

    def file(self, row: RecordedRow, window: str, seed: int, digests: Sequence[str]) -> Path:
        """Where the result of a job is kept; the name changes with whatever changes the result."""
        constants = (UPDATES, TAUGHT_KINDS, STEPS, STRIDE, COPIES)
        return job_file(self.out, ("recorded", VERSION, row.name, row.given, window, seed, digests, constants))


def run_recorded(plan: RecordedPlan, progress: Progress = no_progress) -> pd.DataFrame:
    """Do the jobs that are not done yet, write recorded.md and recorded.csv, and return the long table of scores.

    Columns: row, given, part, site, window, vehicles, kind, score, value, low, high, windows, seeds. `part` is "test"
    (the test vehicles) or "all" (all vehicles, cross-fitted).

    Errors: `InputError` if a row is unknown, or a file cannot be read.
    """
    torch.set_num_threads(1)
    jobs = plan.jobs()
    recordings = Recordings(tuple(read_sites(plan.files)))
    digests = [sha256(path.read_bytes()).hexdigest() for path in plan.files]
    found = finish(
        jobs,
        lambda row, window, seed: plan.file(row, window, seed, digests),
        lambda row, window, seed: _result(recordings, row, window, seed),
        "recorded relations",
        progress,
    )
    results = [
        {"row": row.name, "given": row.given, **part}
        for (row, _, _), parts in zip(jobs, found, strict=True)
        for part in parts
    ]
    if plan.lanes:
        results += _lane_changes(plan, digests)
    table = _over_seeds(pd.DataFrame(results))
    write_whole(plan.out / "recorded.csv", table.to_csv(index=False, float_format="%.4f"))
    write_whole(plan.out / "recorded.md", markdown(table))
    return table


def _lane_changes(plan: RecordedPlan, digests: list[str]) -> list[dict[str, Any]]:
    """Scores of recorded lane changes; made once."""
    path = job_file(plan.out, ("recorded lane changes", VERSION, digests))
    lines = kept(path, lambda: json.loads(lane_change_scores(plan.files).to_json(orient="records")))
    where = {"part": "test", "site": "all", "window": "8 s", "vehicles": "lane changes", "kind": "lane changes"}
    return [{**line, **where} for line in lines]


def _over_seeds(long: pd.DataFrame) -> pd.DataFrame:
    """The mean over seeds; intervals are widened to the least and the greatest seed."""
    return (
        long.groupby(KEYS, sort=False, dropna=False)
        .agg(
            value=("value", "mean"),
            low=("low", "min"),
            high=("high", "max"),
            windows=("windows", "max"),
            seeds=("value", "size"),
        )
        .reset_index()
    )


def _result(recordings: Recordings, row: RecordedRow, window: str, seed: int) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    pooled: dict[tuple[str, str], list[tuple[np.ndarray, np.ndarray]]] = {}
    infer: Infer | None = None
    for fold in range(1 if row.test_part_only else FOLDS):
        if infer is None or row.taught:
            infer = row.prepare(recordings, window, fold, seed)
        answers: dict[tuple[str, str, str], np.ndarray] = {}
        sets = recordings.sets(window, fold)
        for tested in sets:
            crossed = tested.vehicles in CROSSED_VEHICLES and tested.kind in CROSSED_KINDS
            if fold == 0 or crossed:
                p = ask(infer, tested.scenes).follow.numpy()
                answers[tested.site, tested.vehicles, tested.kind] = p
                if crossed:
                    pooled.setdefault((tested.site, tested.kind), []).append((p, tested.cluster))
        if fold == 0:
            found += [line for tested in sets for line in _scores(tested, answers)]
            found += _against_strangers(sets, answers)
    return found if row.test_part_only else [*found, *_cross_fitted(pooled, window)]


def _line(part: str, site: str, window: str, vehicles: str, kind: str, name: str, value: Score, count: int) -> dict:
    where = {"part": part, "site": site, "window": window, "vehicles": vehicles, "kind": kind, "score": name}
    return {**where, **asdict(value), "windows": count}


def _scores(tested: RecordedSet, answers: dict[tuple[str, str, str], np.ndarray]) -> Iterator[dict[str, Any]]:
    """Agreement with the hypothesis, true edges found, and false "follow" from ahead and from behind."""
    p = answers[tested.site, tested.vehicles, tested.kind]
    truth = tested.scenes.graph().numpy() > 0
    ahead = np.broadcast_to(_from_ahead(tested.scenes), truth.shape)
    called = p > 0.5
    values = {
        "agreement": share(called == truth, np.ones_like(truth), tested.cluster),
        "found": share(called, truth, tested.cluster),
        "false_follow": share(called, ~truth & ahead, tested.cluster),
        "false_follow_from_behind": share(called, ~truth & ~ahead, tested.cluster),
    }
    for name, value in values.items():
        if not np.isnan(value.value):
            yield _line(
                "test", tested.site, tested.window, tested.vehicles, tested.kind, name, value, len(tested.cluster)
            )


def _from_ahead(scenes: KnownScenes) -> np.ndarray:
    return np.array([i > j for i, j in pairs(scenes.state.shape[1])])


def _against_strangers(
    sets: Sequence[RecordedSet], answers: dict[tuple[str, str, str], np.ndarray]
) -> Iterator[dict[str, Any]]:
    """AUC of the next vehicle ahead: recorded windows against strangers."""
    by_key = {(tested.site, tested.vehicles, tested.kind): tested for tested in sets}
    for (site, vehicles, kind), tested in by_key.items():
        recorded = by_key.get((site, vehicles, "recorded"))
        if kind != "strangers" or recorded is None:
            continue
        parts = [(answers[site, vehicles, each.kind], each.cluster) for each in (recorded, tested)]
        yield _auc_line("test", site, tested.window, vehicles, parts)


def _cross_fitted(
    pooled: dict[tuple[str, str], list[tuple[np.ndarray, np.ndarray]]], window: str
) -> Iterator[dict[str, Any]]:
    for site in dict.fromkeys(site for site, _ in pooled):
        if (site, "recorded") in pooled and (site, "strangers") in pooled:
            parts = []
            for kind in ("recorded", "strangers"):
                columns = zip(*pooled[site, kind], strict=True)
                p, cluster = (np.concatenate(each) for each in columns)
                parts.append((p, cluster))
            yield _auc_line("all", site, window, "pairs", parts)


def _auc_line(
    part: str, site: str, window: str, vehicles: str, parts: Sequence[tuple[np.ndarray, np.ndarray]]
) -> dict[str, Any]:
    n = 2 if vehicles == "pairs" else 3
    edges = [edge for edge, (i, j) in enumerate(pairs(n)) if i == j + 1]
    p = np.concatenate([each[:, edges].ravel() for each, _ in parts])
    cluster = np.concatenate([np.repeat(each, len(edges)) for _, each in parts])
    truth = np.repeat([True, False], [len(each) * len(edges) for each, _ in parts])
    return _line(part, site, window, vehicles, "strangers", "auc", ranking(p, truth, cluster), len(parts[0][0]))
