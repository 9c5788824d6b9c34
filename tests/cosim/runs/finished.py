"""A small finished run folder that needs no simulation, and damage."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd

from cosim.runs.finished_run import write_manifest
from cosim.runs.run_tables import TABLES, labelled, manifest, write_tables
from cosim.spec.loading import load_scenario
from cosim.world.episode import COLUMNS


def finished_run(folder: Path, speed: float = 20.0, labels: Mapping[str, Any] | None = None) -> Path:
    """A run of one group that was driven for two steps; it is the same group in its counterpart.

    `labels` are the constant columns that a batch puts in front of the groups.
    """
    folder.mkdir(parents=True)
    row = {"episode": 0, "driver": "idm", "counterpart": False, "time": 1.0, "role": 0, "vehicle": "a.0"}
    states = {name: speed for name in COLUMNS} | {"present": True, "driven": True, "during_drive": True}
    steps = pd.DataFrame([row | states | {"time": time, "gap": 9.5, "ttc": 60.0} for time in (1.0, 1.2)])
    facts = {"ending": "horizon", "takeover_time": 1.0, "min_gap": 9.5, "rule": "car_following", "length_0": 5.0}
    groups = pd.DataFrame([{"episode": 0, "driver": "idm"} | facts | {f"vehicle_{k}": f"a.{k}" for k in range(3)}])
    events = pd.DataFrame([row | {"kind": "take_over", "vehicles": "a.0", "detail": ""}]).drop(columns="role")
    graph = {"sender": 1, "receiver": 0, "type": "follow", "probability": 0.75}
    graphs = pd.DataFrame([{"episode": 0, "driver": "idm", "time": 1.0} | graph])
    left = labelled(groups.assign(driver="sumo"), labels or {})
    groups = labelled(groups, labels or {})
    write_tables(folder, dict(zip(TABLES, (steps, groups, left, events, graphs), strict=True)))
    steps[["episode", "driver", "counterpart", "time", "vehicle", *COLUMNS]].to_parquet(folder / "surroundings.parquet")
    (folder / "scenario.json").write_bytes(msgspec.json.encode(load_scenario("us101_car_following")))
    arguments = {"driver": "idm", "seed": 1, "episodes": 1, "starts": 1}
    write_manifest(folder, manifest(arguments, {}, folder))
    return folder


def flip(path: Path, bit: int) -> None:
    """Change one bit of a file in place."""
    content = bytearray(path.read_bytes())
    content[bit // 8 % len(content)] ^= 1 << bit % 8
    path.write_bytes(content)
