"""The safety measures of one drive, the same for runs and for stress tests."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float, Int

from cosim.measures.surrogate_safety import Track, conflicts
from cosim.world.episode import COLUMNS, Episode
from cosim.world.snapshot import LANE_AHEAD
from cosim.world.surroundings import Surroundings

BESIDE, LANES_BESIDE = 25.0, 6.0  # [m] along and across the road, within which vehicles in other lanes are measured
SAME_LANE = 2.0  # [m] across the road


def safety_measures(episode: Episode, third: Sequence[str] | None = None) -> dict[str, float]:
    """The worst value of each measure of `conflicts`, from the first step after the take-over to the end of the drive.

    Where another vehicle joins the group, they are those of the time before.

    Args:
        episode: with its surroundings; without them the measures to other vehicles are those of an empty road.
        third: the vehicles that count as the leader; by default the one that had this role at the take-over.

    Other vehicles are measured where they are less than 80 m away from a driven one in its lane, or less than 25 m
    along the road in a lane beside it.
    """
    driven, end = episode.judged_roles, episode.end
    if not episode.unchanged.all():  # another vehicle joined
        end = min(end, float(episode.time[episode.unchanged][-1]))
    during = (episode.time > episode.group.time + 1e-6) & (episode.time <= end + 1e-6)
    members = [track_of_role(episode, role)[during] for role in episode.followers]
    around = episode.surroundings
    if around is None:
        return conflicts([*members, track_of_role(episode, episode.order[-1])[during]], driven)
    around = around[(around.time > episode.group.time + 1e-6) & (around.time <= end + 1e-6)]
    third = episode.group.ids[-1:] if third is None else third
    known = [around.ids.index(name) for name in third if name in around.ids]
    leaders = [track_of(around, np.flatnonzero(around.vehicle == k)) for k in known]
    others = _near(episode, driven, around)
    own = [k for k, name in enumerate(around.ids) if name in episode.group.ids[:-1]]
    return conflicts(
        [*members, *(leader for leader in leaders if len(leader.time))],
        driven,
        list(_unbroken(others[~np.isin(others.vehicle, [*own, *known])], episode.time)),
    )


def track_of_role(episode: Episode, role: int) -> Track:
    """A vehicle of the group as recorded in the episode; while it is driven, with the acceleration of the dynamics."""
    s, d, x, y, heading, v, a = (episode.state[:, role, COLUMNS.index(name)] for name in COLUMNS)
    xy = np.stack([x, y], axis=1)
    return Track(episode.time, s, d, v, a, xy, heading, float(episode.length[role]), float(episode.width[role]))


def track_of(around: Surroundings, rows: Int[np.ndarray, " R"]) -> Track:
    """One vehicle at these observations of it."""
    length, width = (float(size[rows[0]]) if len(rows) else 0.0 for size in (around.length, around.width))
    s, d, v, a, heading = (around.feature(name)[rows] for name in ("s", "d", "v", "a", "heading"))
    xy = np.stack([around.feature("x")[rows], around.feature("y")[rows]], axis=1)
    return Track(around.time[rows], s, d, v, a, xy, heading, length, width)


def _near(episode: Episode, driven: Sequence[int], around: Surroundings) -> Surroundings:
    """What is near to a driven vehicle at its instant."""
    at = np.searchsorted(episode.time, around.time - 1e-6)
    near = np.zeros(len(around), dtype=bool)
    for role in driven:
        ds = np.abs(around.feature("s") - episode.feature("s")[at, role])
        dd = np.abs(around.feature("d") - episode.feature("d")[at, role])
        near |= ((ds < LANE_AHEAD) & (dd < SAME_LANE)) | ((ds < BESIDE) & (dd < LANES_BESIDE))
    return around[near]


def _unbroken(around: Surroundings, time: Float[np.ndarray, " T"]) -> Iterator[Track]:
    """The track of each vehicle, in parts where it is not observed at every one of these instants."""
    order = np.lexsort((around.time, around.vehicle))
    if not len(order):
        return
    step = np.searchsorted(time, around.time[order] - 1e-6)
    same = (np.diff(around.vehicle[order]) == 0) & (np.diff(step) == 1)
    for rows in np.split(order, np.flatnonzero(~same) + 1):
        yield track_of(around, rows)
