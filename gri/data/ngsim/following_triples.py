"""Recorded car following and its counterexamples, for teaching and testing who reacts to whom.

`recorded_pairs` gives windows in which each vehicle follows the next (the hypothesis), and windows in which nobody can
react: strangers, other lanes, stretched headways, free flow. `recorded_following` gives each kind by its name.
"""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import torch
from torch import Tensor

from gri.data.ngsim.car_following import car_following_triples
from gri.data.ngsim.columns import FRAME
from gri.data.ngsim.defects import clean
from gri.data.ngsim.following_windows import (
    BREAKS,
    HEADWAY,
    NOBODY,
    FollowingWindows,
    joined,
    leaders_leader,
    lengthened,
    strangers,
)
from gri.data.ngsim.lanes_apart import in_different_lanes, one_between_in_next_lane
from gri.data.ngsim.recordings import recordings
from gri.data.ngsim.rules import SPLITS, Rules, splits_of
from gri.data.ngsim.smoothing import Motion, smoothed
from gri.errors import InputError
from gri.progress import Progress, no_progress

RULES = Rules()
LENGTH = 5.0  # [m] of every vehicle of a window
FREE_SPEED, FREE_HEADWAY = 15.0, 65.0
"""Least speed [m/s] and headway [m] of free flow; a headway of 65 m is a gap of 60 m."""
FREE_ADDED = (150.0, 300.0)
"""Range of what is added to headways to make free flow [m]; uniform."""


@dataclass(frozen=True)
class Site:
    """The smoothed recordings of one site."""

    name: str
    motions: tuple[Motion, ...]
    clocks: tuple[int, ...]
    """First step of each recording on a clock that all recordings share [steps]."""


@dataclass(frozen=True)
class Part:
    """Which vehicles of a recording are used."""

    split: str
    fold: int = 0

    def holds(self, vehicle: np.ndarray, rules: Rules) -> np.ndarray:
        """Whether all vehicles of each group [S, N] are of this part."""
        tenths = SPLITS.count("test") * self.fold
        return (splits_of(vehicle - tenths * rules.block, rules) == self.split).all(1)


def read_sites(paths: Sequence[Path], rules: Rules = RULES, progress: Progress = no_progress) -> list[Site]:
    """The recordings of NGSIM files by site. Errors: `InputError` as in `recordings` and `clean`."""
    found: dict[str, list[tuple[Motion, int]]] = {}
    for path in paths:
        for recording in recordings(path, progress=progress):
            clock = round(recording.clock / 1000 / rules.smoothing.dt)
            found.setdefault(recording.site, []).append((smoothed(clean(recording)[0], rules.smoothing), clock))
    return [Site(name, *map(tuple, zip(*parts, strict=True))) for name, parts in sorted(found.items())]


def recorded_pairs(
    paths: Sequence[Path],
    steps: int = 31,
    vehicles: int = 3,
    split: str = "train",
    stride: int = 5,
    copies: int = 2,
    fold: int = 0,
    seed: int = 0,
) -> FollowingWindows:
    """Windows for contrastive teaching, of all sites of NGSIM files; `kind` says which is what.

    Args:
        paths: files in NGSIM's layout.
        steps: T, states per window, 0.2 s apart; 31 are 6 s.
        vehicles: N, 2 or 3.
        split: "train", "validation" or "test" (`splits_of`); no test figure uses the other two.
        stride: steps from one window of the same vehicles to the next.
        copies: windows of strangers per recorded window.
        fold: 0 for the splits of `gri ngsim extract`; 1 to 4 move the test split on by so many fifths.
        seed: of the distances that make free flow.

    Raises:
        InputError: a file cannot be read, or no window obeys the rules.
    """
    parts = []
    for site in read_sites(paths):
        parts += recorded_following(site, steps, vehicles, split, stride, copies, fold, seed).values()
    if not parts:
        raise InputError(
            f"{', '.join(map(str, paths))}: got no window of {steps} steps in split {split!r}; wanted vehicles that"
            " follow each other for so long; give longer recordings or fewer steps"
        )
    return joined(parts)


def recorded_following(
    site: Site,
    steps: int,
    vehicles: int,
    split: str,
    stride: int,
    copies: int = 1,
    fold: int = 0,
    seed: int = 0,
    kinds: Collection[str] | None = None,
) -> Mapping[str, FollowingWindows]:
    """Windows of one site by kind, or only of some `kinds`; kinds without a window are left out.

    In "recorded" each vehicle follows the next one. In "one between, in the next lane" vehicle 0 follows 2. In "vehicle
    0 at constant speed" vehicle 1 still follows 2. In all others nobody follows a vehicle of the window.
    """
    rules = Rules(following_steps=steps, stride=stride, training_stride=stride)
    part = Part(split, fold)
    together = _consecutive(site, vehicles, rules, part)
    following = together.close()
    makers: dict[str, Callable[[], FollowingWindows]] = {
        "recorded": lambda: following,
        "strangers": lambda: strangers(following, copies),
        "different lanes": lambda: _lanes(site, vehicles, rules, part, "different lanes"),
        **{name: partial(broken, following) for name, broken in BREAKS.items()},
        "headway + 150 to 300 m": lambda: _far(together, seed),
        "free flow, headway added": lambda: _fast(_far(together, seed)).named("free flow, headway added"),
        "free flow, recorded": lambda: _free_flow(site, vehicles, rules, part),
    }
    if vehicles == 3:
        between = "one between, in the next lane"
        makers[between] = lambda: _lanes(site, 3, rules, part, between)
    else:
        makers["the leader's leader"] = lambda: leaders_leader(_consecutive(site, 3, rules, part)).close()
    found = {name: make() for name, make in makers.items() if kinds is None or name in kinds}
    return {name: windows for name, windows in found.items() if len(windows)}


def _far(windows: FollowingWindows, seed: int) -> FollowingWindows:
    generator = torch.Generator().manual_seed(seed)
    low, high = FREE_ADDED
    shape = (len(windows), windows.state.shape[1] - 1)
    added = low + (high - low) * torch.rand(shape, generator=generator, dtype=torch.float64)
    return lengthened(windows, added, "headway + 150 to 300 m")


def _fast(windows: FollowingWindows) -> FollowingWindows:
    return windows[(windows.state[..., 1] >= FREE_SPEED).all(-1).all(-1)]


def _free_flow(site: Site, vehicles: int, rules: Rules, part: Part) -> FollowingWindows:
    """Recorded windows with the speeds and headways of free flow."""
    known = _consecutive(site, vehicles, msgspec.structs.replace(rules, spacing=np.inf), part)
    apart = known[(known.headways() >= FREE_HEADWAY).all(-1).all(-1)]
    return _fast(replace(apart, leader=torch.full_like(apart.leader, NOBODY))).named("free flow, recorded")


def _consecutive(site: Site, vehicles: int, rules: Rules, part: Part) -> FollowingWindows:
    """Windows in which each vehicle follows the next in one lane, `rules.spacing` apart at most."""
    parts = []
    for motion, clock in zip(site.motions, site.clocks, strict=True):
        rows = car_following_triples(motion, rules, Counter(), vehicles)
        rows = rows[part.holds(motion.vehicle[rows[:, :, 0]], rules)]
        leader = torch.tensor([*range(1, vehicles), NOBODY]).expand(len(rows), vehicles)
        parts.append(_windows(motion, clock, rows, leader, "recorded", rules))
    return joined(parts)


def _lanes(site: Site, vehicles: int, rules: Rules, part: Part, kind: str) -> FollowingWindows:
    """Windows whose vehicles are not all in one lane."""
    parts = []
    for motion, clock in zip(site.motions, site.clocks, strict=True):
        if kind == "different lanes":
            rows, leader = in_different_lanes(motion, vehicles, rules, HEADWAY), [NOBODY] * vehicles
        else:
            rows, leader = one_between_in_next_lane(motion, rules, HEADWAY), [2, NOBODY, NOBODY]
        rows = rows[part.holds(motion.vehicle[rows[:, :, 0]], rules)]
        parts.append(
            _windows(motion, clock, rows, torch.tensor(leader).expand(len(rows), vehicles), kind, rules).close()
        )
    return joined(parts)


def _windows(motion: Motion, clock: int, rows: np.ndarray, leader: Tensor, kind: str, rules: Rules) -> FollowingWindows:
    """Windows of rows [S, N, T], with x from the start of vehicle 0 and every vehicle `LENGTH` long."""
    x, v, a = (torch.from_numpy(getattr(motion, name)[rows]).double() for name in ("x", "vx", "ax"))
    length = torch.from_numpy(motion.length[rows[:, 1:, 0]]).double()
    shift = torch.where(length > 0, LENGTH - length, 0.0).cumsum(1)  # 0 where no length was recorded
    x = torch.cat([x[:, :1], x[:, 1:] + shift[..., None]], 1)
    return FollowingWindows(
        torch.stack([x - x[:, :1, :1], v, a], -1),
        leader.clone(),
        torch.from_numpy(motion.vehicle[rows[:, :, 0]]).long(),
        torch.from_numpy(motion.lane[rows[:, :, 0]]).long(),
        torch.from_numpy(clock + motion.step[rows[:, 0, 0]]).long(),
        np.full(len(rows), kind, object),
        rules.smoothing.every * FRAME,
    )
