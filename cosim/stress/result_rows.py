"""From what happened to one group to one row of a stress test's table."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cosim.loop.perturbed_round import Change
from cosim.measures import surrogate_safety
from cosim.measures.surrogate_safety import Track
from cosim.world.episode import COLUMNS, INTERRUPTED, Ending, Episode, EventKind
from cosim.world.groups import SAME_LANE
from cosim.world.snapshot import Snapshot

OTHER, CUTTER = "other", "cutter"


def row_of(
    episode: Episode,
    change: Change,
    before: Snapshot,
    trace: Sequence[Snapshot],
    driven: Sequence[int],
    third_gone: bool,
) -> dict[str, Any]:
    """Outcome and measures of one drive, whoever drove.

    `before` is the take-over, `trace` what was seen after each step since. Conflicts and comfort are looked at from the
    first step on to the end of the drive, comfort without the first step, in which a displaced start shows; the
    follower as long as anybody of its round is driven.
    """
    way = (episode.time > episode.group.time + 1e-6) & (episode.time <= episode.end + 1e-6)
    owned = [_own(episode, role)[way] for role in (0, 1)]
    names = [] if third_gone else [episode.group.ids[2]]
    names += [change.successor] if change.successor is not None else []
    others = [_seen(trace, name, episode.end) for name in names]
    d = episode.feature("d")[episode.during_drive]
    return {
        "ending": episode.ending.value,
        "counted": episode.ending not in INTERRUPTED,
        "success": bool(episode.success),
        "contact": episode.ending is Ending.CONTACT,
        "hit": _hit(episode, change, trace) if episode.ending is Ending.CONTACT else "",
        "drive_duration": episode.end - episode.group.time,
        "lateral_change": float(abs(d[-1, 1] - d[-1, 0]) - abs(d[0, 1] - d[0, 0])),
        **surrogate_safety.conflicts([*owned, *(track for track in others if len(track.time))], (0, 1)),
        **surrogate_safety.comfort([owned[role][1:] for role in driven if len(owned[role].time) > 1] or owned),
        **_follower(episode, before, trace),
    }


def _own(episode: Episode, role: int) -> Track:
    """A vehicle of the group as the episode has it: with the dynamics' own acceleration while it is driven."""
    s, d, x, y, heading, v, a = (episode.state[:, role, COLUMNS.index(name)] for name in COLUMNS)
    xy = np.stack([x, y], axis=1)
    return Track(episode.time, s, d, v, a, xy, heading, float(episode.length[role]), float(episode.width[role]))


def _seen(snapshots: Sequence[Snapshot], vehicle: str, until: float = np.inf) -> Track:
    """A vehicle at all instants at which it was seen."""
    found = [(now, now.ids.index(vehicle)) for now in snapshots if vehicle in now.ids and now.time <= until + 1e-6]
    time, s, d, v, a, heading = (
        np.array([getattr(now, name) if name == "time" else getattr(now, name)[row] for now, row in found])
        for name in ("time", "s", "d", "v", "a", "heading")
    )
    xy = np.array([now.xy[row] for now, row in found]).reshape(-1, 2)
    length, width = (float(getattr(found[0][0], name)[found[0][1]]) if found else 0.0 for name in ("length", "width"))
    return Track(time, s, d, v, a, xy, heading, length, width)


def _follower(episode: Episode, before: Snapshot, trace: Sequence[Snapshot]) -> dict[str, float]:
    """What the first vehicle behind the group went through; nothing where there is none."""
    rear = before.ids.index(episode.group.ids[episode.order[0]])
    distance = before.s[rear] - before.s
    behind = (np.abs(before.d - before.d[rear]) < SAME_LANE) & (distance > 0)
    if not behind.any():
        return {}
    track = _seen([before, *trace], before.ids[int(np.where(behind, distance, np.inf).argmin())])
    return surrogate_safety.effect_on(track) if len(track.time) > 1 else {}


def _hit(episode: Episode, change: Change, trace: Sequence[Snapshot]) -> str:
    """Who ran into whom, e.g. "0→1": of the two that touch the one whose front is farther back is said to hit."""
    now = next(snapshot for snapshot in trace if snapshot.time >= episode.end - 1e-6)
    names = dict(zip(episode.group.ids, "012", strict=True))
    if change.successor is not None:
        names[change.successor] = CUTTER
    contact = next(event for event in episode.events if event.kind is EventKind.CONTACT)
    pair = sorted(contact.vehicles, key=lambda vehicle: float(now.s[now.ids.index(vehicle)]))
    return "→".join(names.get(vehicle, OTHER) for vehicle in pair)
