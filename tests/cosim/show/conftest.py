"""One hand-made episode: 0 follows 1 follows 2, and all brake slightly."""

from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest

from cosim.runs.finished_run import write_manifest
from cosim.runs.road_view import RoadView, road_view
from cosim.runs.run_tables import manifest
from cosim.show.episode_view import EpisodeView, episode_view
from cosim.spec.loading import load_scenario
from cosim.world.episode import COLUMNS


@pytest.fixture
def tables() -> dict[str, pd.DataFrame]:
    """The tables of a run with one episode, taken over after 1 s, driven for 3 s; the counterpart is 2 m behind."""
    time = np.round(np.arange(0, 5.01, 0.2), 10)
    a = np.stack([-0.5 - 0.2 * np.sin(time), -0.4 + 0 * time, -0.3 + 0 * time], 1)
    v = 10.0 + np.cumsum(a, axis=0) * 0.2
    s = np.cumsum(v, axis=0) * 0.2 + np.array([0.0, 20.0, 40.0])
    rows, driven = len(time), (time > 1.0) & (time <= 4.0)
    wide = dict.fromkeys(COLUMNS, np.zeros((rows, 3))) | {"s": s, "x": s, "v": v, "a": a}
    gap = np.hstack([np.diff(s, axis=1) - 5.0, np.full((rows, 1), np.nan)])
    steps = pd.DataFrame(
        {
            "episode": 0, "driver": "gri", "counterpart": False, "time": np.repeat(time, 3),
            "role": np.tile(np.arange(3), rows),
            "present": True, "driven": (driven[:, None] & [True, True, False]).ravel(),
            "during_drive": np.repeat((time >= 1.0) & (time <= 4.0), 3), "gap": gap.ravel(), "ttc": np.inf,
            **{name: values.ravel() for name, values in wide.items()},
        }
    )  # fmt: skip
    group = {"episode": 0, "driver": "gri", "takeover_time": 1.0, "drive_duration": 3.0, "ending": "horizon"}
    for role in range(3):
        group |= {f"vehicle_{role}": f"</script>{role}", f"length_{role}": 5.0, f"width_{role}": 1.8}
    graphs = pd.DataFrame(
        [(0, "gri", 1.0, i, j, "follow" if i == j + 1 else "none", 0.97) for i in range(3) for j in range(3) if i != j]
        + [(0, "gri", 2.0, 1, 0, "none", 0.6)],
        columns=["episode", "driver", "time", "sender", "receiver", "type", "probability"],
    )
    left = steps.assign(driver="sumo", counterpart=True, driven=False, s=steps["s"] - 2.0, x=steps["x"] - 2.0)
    return {
        "steps": pd.concat([steps, left], ignore_index=True), "groups": pd.DataFrame([group]), "graphs": graphs,
        "counterparts": pd.DataFrame([group | {"driver": "sumo"}]), "events": pd.DataFrame(),
    }  # fmt: skip


@pytest.fixture
def episode(tables) -> EpisodeView:
    return episode_view(tables, 0)


@pytest.fixture
def road(tables) -> RoadView:
    return road_view(tables, 0)


@pytest.fixture
def run_folder(tables, tmp_path) -> Path:
    """A run folder with the lanes of US-101 and one vehicle beside the group, 1 m ahead of the leader."""
    (tmp_path / "scenario.json").write_bytes(msgspec.json.encode(load_scenario("us101_car_following")))
    steps = tables["steps"]
    own = steps[~steps["counterpart"] & (steps["time"] >= 1.0)]
    beside = own[own["role"] == 2].assign(vehicle="<b>beside</b>", length=7.0, width=2.0)
    beside = beside.assign(s=beside["s"] + 1.0, x=beside["x"] + 1.0, d=-3.5, y=-3.5)
    around = pd.concat([own.assign(vehicle="member", length=5.0, width=1.8), beside])
    columns = ["episode", "driver", "counterpart", "time", "vehicle", *COLUMNS, "length", "width"]
    around[columns].to_parquet(tmp_path / "surroundings.parquet", index=False)
    write_manifest(tmp_path, manifest({"driver": "gri", "seed": 1, "episodes": 1}, {}, tmp_path))
    return tmp_path
