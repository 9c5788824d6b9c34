"""Writing a run: Parquet tables for steps, groups, counterparts, events and graphs, a manifest, and one picture.

Columns and units are in docs/reference/run-tables.md: SI units, e.g. jerk in m/s³. A run folder appears whole or not at
all: it is written beside its place and then moved there.

The counterpart of a driven group is the same group left to SUMO, or as it was recorded. It has the number of its
episode. Counterparts have a table of their own; in `steps` and `events` the column `counterpart` marks their rows.
"""

import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from jaxtyping import Bool

from cosim.measures.surrogate_safety import BRAKING, brakings
from cosim.runs.finished_run import SCENARIO
from cosim.runs.run_reading import TABLES
from cosim.spec.input_files import sha256
from cosim.spec.scenario import AFTERMATH
from cosim.world.counterparts import leader_deviation
from cosim.world.episode import COLUMNS, Episode
from cosim.world.hand_back_columns import hand_back_columns
from cosim.world.outcome_columns import filter_columns, outcome_columns
from cosim.world.safety import safety_measures, track_of_role
from gri.core.edges import MOST_COMPLETE, EdgeType, pairs

# Types of the columns of the tables that can be without rows, from which no type could be read.
GRAPH_TYPES = {
    "episode": "int32",
    "driver": "str",
    "time": "float64",
    "sender": "int64",
    "receiver": "int64",
    "type": "str",
    "probability": "float64",
    "in_doubt": "bool",
    "unknown": "float64",
}
EVENT_TYPES = {
    "episode": "int32",
    "driver": "str",
    "counterpart": "bool",
    "time": "float64",
    "kind": "str",
    "vehicles": "str",
    "detail": "str",
}


def steps_table(episodes: Sequence[Episode], counterparts: Sequence[Episode] = ()) -> pd.DataFrame:
    """One row per episode, instant and vehicle; `gap` and `ttc` are towards the next vehicle of the group.

    The k-th counterpart belongs to the k-th episode and gets its number.
    """
    return pd.concat([_steps(*numbered) for numbered in _numbered(episodes, counterparts)], ignore_index=True)


def _numbered(episodes: Sequence[Episode], counterparts: Sequence[Episode]) -> Iterator[tuple[np.int32, Episode, bool]]:
    """Each episode with its number and whether it is a counterpart."""
    for is_counterpart, part in enumerate((episodes, counterparts)):
        for number, episode in enumerate(part):
            yield np.int32(number), episode, bool(is_counterpart)


def _steps(number: np.int32, episode: Episode, counterpart: bool) -> pd.DataFrame:
    n = len(episode.time)
    size = len(episode.order)
    towards = {name: np.full((n, size), np.nan) for name in ("gap", "ttc")}
    held = episode.held[:, episode.order]
    for name in towards:  # lengths are those of the take-over
        towards[name][:, episode.order[:-1]] = np.where(held[:, 1:] & held[:, :-1], getattr(episode, name), np.nan)
    return pd.DataFrame(
        {
            "episode": number,
            "driver": episode.driver,
            "counterpart": counterpart,
            "time": np.repeat(episode.time, size),
            "role": np.tile(np.arange(size, dtype=np.int8), n),
            "vehicle": [vehicle for of in episode.members for vehicle in of],
            "present": episode.valid.ravel(),
            "driven": episode.driven.ravel(),
            "during_drive": np.repeat(episode.during_drive, size),
            **{name: episode.state[..., k].ravel() for k, name in enumerate(COLUMNS)},
            "jerk": episode.jerk.ravel(),
            **{name: values.ravel() for name, values in towards.items()},
        }
    )


def groups_table(
    episodes: Sequence[Episode], expected: Mapping[tuple[int, int], EdgeType], left: Sequence[Episode] = ()
) -> pd.DataFrame:
    """One row per episode: vehicles, ending, inferred graph, and the safety figures of the drive (SI units).

    If the counterparts of the episodes are given (`left`), there is also the deviation of the leader from them.
    """
    table = pd.DataFrame([_group(number, episode, expected) for number, episode in enumerate(episodes)])
    if left:
        table["leader_deviation"] = [leader_deviation(*pair) for pair in zip(episodes, left, strict=True)]
    return table


def _group(number: int, episode: Episode, expected: Mapping[tuple[int, int], EdgeType]) -> dict[str, Any]:
    way = episode.during_drive
    own = episode.held[way][:, :-1]
    after = (episode.time > episode.end + 1e-6)[:, None] & episode.valid[:, :-1]
    speed, acceleration, jerk = (x[way][:, :-1] for x in (episode.feature("v"), episode.feature("a"), episode.jerk))
    owned_jerk = np.abs(jerk[1:][own[1:]])
    return {
        "episode": np.int32(number),
        "driver": episode.driver,
        **{f"vehicle_{role}": vehicle for role, vehicle in enumerate(episode.group.ids)},
        **{f"length_{role}": float(length) for role, length in enumerate(episode.length)},
        **{f"width_{role}": float(width) for role, width in enumerate(episode.width)},
        "rule": "car_following" if episode.in_lane else "merge",
        "takeover_time": episode.group.time,
        "drive_duration": episode.end - episode.group.time,
        "joined": len({change.time for change in episode.role_changes}),
        "ending": episode.ending.value,
        **outcome_columns(episode),
        **filter_columns(episode),
        **_inferred_graph_columns(episode, expected),
        **safety_measures(episode),
        "mean_speed": float(speed[own].mean()),
        "jerk_within_3": float((owned_jerk <= 3).mean()) if owned_jerk.size else np.nan,
        "min_acceleration": float(acceleration[own].min()),
        **_brakings(episode, way, ""),
        **_brakings(episode, episode.time > episode.end + 1e-6, "_after"),
        "min_acceleration_after": float(np.where(after, episode.feature("a")[:, :-1], np.inf).min()),
        **hand_back_columns(episode),
    }


def _brakings(episode: Episode, when: Bool[np.ndarray, " T"], suffix: str) -> dict[str, int]:
    """How often a driven vehicle begins to brake harder than each threshold of BRAKING at these instants."""
    when = (when & (episode.time <= episode.end + AFTERMATH + 1e-6))[:, None] & episode.valid & episode.held
    tracks = [track_of_role(episode, role)[when[:, role]] for role in episode.judged_roles]
    return {
        f"brakings_{threshold:.0f}{suffix}": sum(brakings(track, threshold) for track in tracks if len(track.time))
        for threshold in BRAKING
    }


def reported_pairs(size: int) -> tuple[tuple[int, int], ...]:
    """The pairs with columns of their own: all pairs of two or three vehicles, else those of neighbours."""
    return tuple((i, j) for i, j in pairs(size) if size <= MOST_COMPLETE or abs(i - j) == 1)


def _inferred_graph_columns(episode: Episode, expected: Mapping[tuple[int, int], EdgeType]) -> dict[str, Any]:
    """The inferred type and its probability for each reported pair, and whether the whole graph is the expected one.

    All are missing for a driver without a graph.
    """
    reported = reported_pairs(len(episode.order))
    if episode.graph is None:
        edges = {f"edge_{i}_{j}{of}": missing for i, j in reported for of, missing in (("", None), ("_p", np.nan))}
        return {**edges, "graph_as_expected": None, "graph_unknown": np.nan, "reacts_in_doubt": False}
    inferred = replace(episode.graph, in_doubt=None)
    graph = inferred.on(reported)
    types = [graph.vocabulary[k] for k in graph.map[0].tolist()]
    probabilities = graph.probs[0].max(1).values.tolist()
    belief: dict[str, Any] = {}
    for (i, j), kind, p in zip(reported, types, probabilities, strict=True):
        belief[f"edge_{i}_{j}"] = kind.value
        belief[f"edge_{i}_{j}_p"] = p
    whole = dict.fromkeys(expected, EdgeType.NONE) | {pair: kind for pair, (kind, _) in inferred.edges().items()}
    belief["graph_as_expected"] = all(kind is expected.get(pair, EdgeType.NONE) for pair, kind in whole.items())
    belief["graph_unknown"] = np.nan if graph.unknown is None else float(graph.unknown[0])
    belief["reacts_in_doubt"] = episode.graph.in_doubt is not None and bool(episode.graph.in_doubt.any())
    return belief


def graphs_table(episodes: Sequence[Episode]) -> pd.DataFrame:
    """One row per episode, inference and pair: the type used, its probability, and how unknown the scene is."""
    rows = [
        (np.int32(number), episode.driver, time, i, j, graph.vocabulary[k].value, p, in_doubt, unknown)
        for number, episode in enumerate(episodes)
        if (graph := episode.graph) is not None
        for time, types, probabilities, doubted, unknown in zip(
            episode.graph_time,
            graph.map.tolist(),
            graph.probs.gather(-1, graph.map[..., None])[..., 0].tolist(),
            (torch.zeros_like(graph.map, dtype=torch.bool) if graph.in_doubt is None else graph.in_doubt).tolist(),
            [np.nan] * len(graph) if graph.unknown is None else graph.unknown.tolist(),
            strict=True,
        )
        for (i, j), k, p, in_doubt in zip(graph.pairs, types, probabilities, doubted, strict=True)
    ]
    return pd.DataFrame(rows, columns=list(GRAPH_TYPES)).astype(GRAPH_TYPES)


def labelled(table: pd.DataFrame, labels: Mapping[str, Any]) -> pd.DataFrame:
    """The table with a constant column per label in front; None is a missing number."""
    columns = {name: np.nan if value is None else value for name, value in labels.items()}
    return pd.concat([pd.DataFrame(columns, index=table.index), table], axis=1)


def events_table(episodes: Sequence[Episode], counterparts: Sequence[Episode] = ()) -> pd.DataFrame:
    """One row per event."""
    rows = [
        (
            number,
            episode.driver,
            counterpart,
            event.time,
            event.kind.value,
            " ".join(event.vehicles),
            event.detail,
        )
        for number, episode, counterpart in _numbered(episodes, counterparts)
        for event in episode.events
    ]
    return pd.DataFrame(rows, columns=list(EVENT_TYPES)).astype(EVENT_TYPES)


def manifest(arguments: Mapping[str, Any], inputs: Mapping[str, Path], folder: Path) -> dict[str, Any]:
    """Versions, arguments and hashes: what it takes to get the same tables again, and to see that they are."""
    packages = ("gri-cosim", "libsumo", "torch", "numpy", "pandas", "pyarrow")
    return {
        "arguments": dict(arguments),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in packages}},
        "machine": {"system": platform.system(), "processor": platform.machine(), "cores": os.cpu_count()},
        "inputs": {name: {"file": path.name, "sha256": sha256(path)} for name, path in inputs.items()},
        "results": {path.name: sha256(path) for path in _result_files(folder)},
    }


def _result_files(folder: Path) -> list[Path]:
    return sorted(path for pattern in ("*.parquet", SCENARIO) for path in folder.glob(pattern))


def write_tables(folder: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Write each table with the same types of columns in every run, so that the tables of many runs can be joined."""
    for name in TABLES:
        table = pa.Table.from_pandas(tables[name], preserve_index=False)
        for k, field in enumerate(table.schema):
            if pa.types.is_null(field.type):  # every value is missing
                kind = pa.bool_() if field.name == "graph_as_expected" else pa.string()
                table = table.set_column(k, field.with_type(kind), table.column(k).cast(kind))
        pq.write_table(table, folder / f"{name}.parquet")
