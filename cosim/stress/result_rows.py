"""The rows of a stress test's table: one from the drive of one group, and their comparison with SUMO's rows."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from cosim.loop.intervention import GroupChange
from cosim.measures import surrogate_safety
from cosim.measures.surrogate_safety import Track
from cosim.world.break_ups import do_the_same
from cosim.world.episode import INTERRUPTED, BrokenUpBy, Episode, LaneEntry
from cosim.world.groups import SAME_LANE
from cosim.world.outcome_columns import filter_columns, outcome_columns
from cosim.world.safety import safety_measures, track_of_role
from cosim.world.snapshot import Snapshot

SUMO = "sumo"  # name of the policy that leaves the groups to SUMO


def result_row(
    episode: Episode,
    change: GroupChange,
    before: Snapshot,
    trace: Sequence[Snapshot],
    driven: Sequence[int],
    third_gone: bool,
) -> dict[str, Any]:
    """Outcome and measures of one drive, whichever policy drove.

    `before` is the snapshot at the take-over, `trace` has one snapshot per driven step after it, `driven` are the roles
    that the policy drove. Conflicts and comfort are measured from the first step to the end of the drive; comfort
    leaves out the first step, which contains the jump of a displaced start, and vehicles that lost their role. The
    follower is measured as long as any group of the round is driven.
    """
    during = (episode.time > episode.group.time + 1e-6) & (episode.time <= episode.end + 1e-6)
    own = [track_of_role(episode, role)[during & episode.held[:, role]] for role in episode.followers]
    names = [] if third_gone else [episode.group.leader]
    names += [change.successor] if change.successor is not None else []
    d = episode.feature("d")[episode.during_drive]
    return {
        "ending": episode.ending.value,
        "counted": episode.ending not in INTERRUPTED,
        **outcome_columns(episode),
        **filter_columns(episode),
        "intruders": _written(episode.intruders),
        "lane_entries": _written(episode.lane_entries),
        "drive_duration": episode.end - episode.group.time,
        "joined": len({change.time for change in episode.role_changes}),
        "lateral_change": float(abs(d[-1, 1] - d[-1, 0]) - abs(d[0, 1] - d[0, 0])),
        **safety_measures(episode, names),
        **surrogate_safety.comfort([own[role][1:] for role in driven if len(own[role].time) > 1] or own),
        **_effect_on_follower(episode, before, trace),
    }


def _track_of_vehicle(snapshots: Sequence[Snapshot], vehicle: str) -> Track:
    """A vehicle at all instants at which it is in a snapshot."""
    found = [(now, now.ids.index(vehicle)) for now in snapshots if vehicle in now.ids]
    time, s, d, v, a, heading = (
        np.array([getattr(now, name) if name == "time" else getattr(now, name)[row] for now, row in found])
        for name in ("time", "s", "d", "v", "a", "heading")
    )
    xy = np.array([now.xy[row] for now, row in found]).reshape(-1, 2)
    length, width = (float(getattr(found[0][0], name)[found[0][1]]) if found else 0.0 for name in ("length", "width"))
    return Track(time, s, d, v, a, xy, heading, length, width)


def _effect_on_follower(episode: Episode, before: Snapshot, trace: Sequence[Snapshot]) -> dict[str, float]:
    """The effect of the drive on the first vehicle behind the group; empty without such a vehicle."""
    rear = before.ids.index(episode.group.ids[episode.order[0]])
    distance = before.s[rear] - before.s
    behind = (np.abs(before.d - before.d[rear]) < SAME_LANE) & (distance > 0)
    if not behind.any():
        return {}
    track = _track_of_vehicle([before, *trace], before.ids[int(np.where(behind, distance, np.inf).argmin())])
    return surrogate_safety.effect_on(track) if len(track.time) > 1 else {}


def compared_with_sumo(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows with `broken_up_by` OTHERS instead of UNKNOWN where an intruder does the same under the policy `sumo`.

    The row of `sumo` on the same start, and under the same perturbation and intensity, is the counterpart. Without it
    the cause stays unknown.
    """
    key = ["seed", "start", "perturbation", "intensity"]
    left = rows.loc[rows["policy"] == SUMO].drop_duplicates(key).set_index(key)["lane_entries"].dropna()
    entries = {_hashable(where): _read(text) for where, text in left.items()}
    unknown = rows["broken_up_by"] == BrokenUpBy.UNKNOWN.value
    same = [
        do_the_same(_read(intruders), entries.get(_hashable(where), ()))
        for intruders, *where in rows.loc[unknown, ["intruders", *key]].itertuples(index=False)
    ]
    causes = rows["broken_up_by"].copy()
    causes[unknown] = [BrokenUpBy.OTHERS.value if others else BrokenUpBy.UNKNOWN.value for others in same]
    return rows.assign(broken_up_by=causes)


def _hashable(where: Any) -> tuple[str, ...]:
    """A start and a cell as a key; undisturbed cells have a missing intensity, which is not equal to itself."""
    return tuple(map(str, where))


def _written(entries: Sequence[LaneEntry]) -> str:
    return " ".join(f"{entry.vehicle}@{entry.time:.2f}" for entry in entries)


def _read(text: str) -> tuple[LaneEntry, ...]:
    pairs = (entry.rpartition("@") for entry in text.split())
    return tuple(LaneEntry(vehicle, float(time)) for vehicle, _, time in pairs)
