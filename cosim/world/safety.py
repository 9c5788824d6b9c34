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

    Where another vehicle joins the group, it is a member from then on, and whom it replaced is another vehicle. A
    vehicle counts as driven until it loses its role. A post-encroachment is measured among the same members.

    Args:
        episode: with its surroundings; without them the measures to other vehicles are those of an empty road, and
            so are those of vehicles that joined.
        third: the vehicles that count as the leader; by default the one that had this role at the take-over. Only
            while nobody joined.

    Other vehicles are measured where they are less than 80 m away from a driven one in its lane, or less than 25 m
    along the road in a lane beside it.
    """
    if third is None and episode.safety is not None:
        return dict(episode.safety)
    first, *later = episode.spells
    found = [_during(episode, *first, first[2][-1:] if third is None else third)]
    found += [_during(episode, *spell, spell[2][-1:]) for spell in later]
    return {name: (max if name.startswith("max_") else min)(spell[name] for spell in found) for name in found[0]}


def _during(
    episode: Episode, begin: float, until: float, ids: Sequence[str], kept: Sequence[int], third: Sequence[str]
) -> dict[str, float]:
    """The measures from one instant to before another [s], while these vehicles have the roles, some as at first."""
    after, end = max(begin - 1e-6, episode.group.time + 1e-6), min(until - 2e-6, episode.end) + 1e-6
    during = (episode.time > after) & (episode.time <= end)
    own = [role for role in episode.followers if role in kept]
    members = {role: track_of_role(episode, role)[during] for role in own}
    driven = [own.index(role) for role in episode.judged_roles if role in own]
    around = episode.surroundings
    if around is None:
        alone = [track_of_role(episode, episode.order[-1])[during]] if episode.order[-1] in kept else []
        return conflicts([*members.values(), *alone], driven)
    around = around[(around.time > after) & (around.time <= end)]
    joined = [ids[role] for role in episode.followers if role not in members]
    known = [around.ids.index(name) for name in [*joined, *third] if name in around.ids]
    more = [track_of(around, np.flatnonzero(around.vehicle == k)) for k in known]
    others = _near(episode, [role for role in episode.judged_roles if role in own], around)
    told = [k for k, name in enumerate(around.ids) if name in [ids[role] for role in own]]
    return conflicts(
        [*members.values(), *(track for track in more if len(track.time))],
        driven,
        list(_unbroken(others[~np.isin(others.vehicle, [*told, *known])], episode.time)),
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
