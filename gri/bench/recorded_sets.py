"""The test sets of recorded traffic: recorded car following, and controls in which nobody can react.

Vehicles are apart: those of the test part are in no window for teaching or for choosing a threshold. The five folds of
cross-fitting are five such divisions; together they test every vehicle once.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Int

from gri.bench.car_following_scenes import KnownScenes
from gri.data.ngsim.following_triples import Site, recorded_following
from gri.data.ngsim.following_windows import FollowingWindows, joined
from gri.networks.pair_encoder import PairEncoder

FOLDS = 5
STRIDE = {"test": 10, "train": 5}  # steps from one window of the same vehicles to the next
COPIES = 2  # windows of strangers per recorded window
STEPS = {"6 s": 31, "12 s": 61}
VEHICLES = {"pairs": 2, "triples": 3}
CROSSED_VEHICLES, CROSSED_KINDS = ("pairs",), ("recorded", "strangers")
"""What is tested in all folds."""


def as_scenes(windows: FollowingWindows) -> KnownScenes:
    """Windows as scenes of the benchmark; rows may see all their states."""
    return KnownScenes(windows.state, windows.leader, 1.0, windows.state.shape[2])


@dataclass(frozen=True)
class RecordedSet:
    """Windows of one kind, site, length and number of vehicles."""

    site: str
    kind: str
    vehicles: str
    """"pairs" or "triples"."""
    window: str
    """"6 s" or "12 s"."""
    scenes: KnownScenes
    cluster: Int[np.ndarray, " S"]
    """Windows of one following vehicle are not independent; its number."""


@dataclass(frozen=True)
class Recordings:
    """All sites of the files, and the windows made of them so far."""

    sites: tuple[Site, ...]
    taught: dict[tuple[object, ...], PairEncoder] = field(default_factory=dict)
    """Encoders that rows keep from one window length to the next."""
    _made: dict[tuple[object, ...], Mapping[str, FollowingWindows]] = field(default_factory=dict)

    def windows(
        self, site: Site, window: str, vehicles: str, split: str, fold: int, kinds: tuple[str, ...] | None = None
    ) -> Mapping[str, FollowingWindows]:
        """Windows by kind of one part of a site; all kinds, or these."""
        key = (site.name, window, vehicles, split, fold, kinds)
        if key not in self._made:
            self._made[key] = recorded_following(
                site, STEPS[window], VEHICLES[vehicles], split, STRIDE[split], COPIES, fold, kinds=kinds
            )
        return self._made[key]

    def training(self, window: str, vehicles: str, fold: int, kinds: tuple[str, ...]) -> FollowingWindows:
        """Windows of these kinds for teaching, of all sites together."""
        parts = [self.windows(site, window, vehicles, "train", fold, kinds) for site in self.sites]
        return joined([part[kind] for part in parts for kind in kinds if kind in part])

    def sets(self, window: str, fold: int) -> list[RecordedSet]:
        """The test sets of one fold: all of them in fold 0, in others only those that are cross-fitted."""
        return [
            RecordedSet(site.name, kind, vehicles, window, as_scenes(part), part.vehicle[:, 0].numpy())
            for site in self.sites
            for vehicles in (VEHICLES if fold == 0 else CROSSED_VEHICLES)
            for kind, part in self.windows(
                site, window, vehicles, "test", fold, CROSSED_KINDS if fold else None
            ).items()
        ]


def balanced(windows: FollowingWindows) -> FollowingWindows:
    """As many windows of "recorded" as of all other kinds together: recorded ones are repeated."""
    recorded = torch.from_numpy(windows.kind == "recorded")
    positive, negative = recorded.nonzero()[:, 0], (~recorded).nonzero()[:, 0]
    repeated = positive.repeat(max(1, round(len(negative) / max(1, len(positive)))))
    return windows[torch.cat([repeated, negative])]
