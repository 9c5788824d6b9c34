"""One hand-made episode: 0 follows 1 follows 2, and all brake slightly."""

import numpy as np
import pandas as pd
import pytest

from cosim.show.episode_view import EpisodeView, episode_view
from cosim.world.episode import COLUMNS


@pytest.fixture
def tables() -> dict[str, pd.DataFrame]:
    """The tables of a run with this one episode, taken over after 1 s and driven for 3 s."""
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
    return {"steps": steps, "groups": pd.DataFrame([group]), "graphs": graphs, "events": pd.DataFrame()}


@pytest.fixture
def episode(tables) -> EpisodeView:
    return episode_view(tables, 0)
