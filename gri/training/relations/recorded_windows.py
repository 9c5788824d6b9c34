"""Windows of recorded car following, and windows broken on purpose, for contrastive teaching.

That each recorded vehicle follows the next one is a hypothesis, and it is the only thing assumed. In the broken windows
(strangers, other lanes, stretched headways, free flow; `gri.data.ngsim.following_triples`) no vehicle can react to
another one, whatever drivers do.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.data.ngsim.following_triples import Site, recorded_following
from gri.data.ngsim.following_windows import joined
from gri.errors import InputError
from gri.networks.pair_encoder import PairEncoderConfig
from gri.relations.reaction_scenes import UNSEEN, Reactions

VEHICLES = (2, 3)  # pairs and triples
KINDS = (
    "recorded",
    "strangers",
    "different lanes",
    "headway x 4",
    "headway x 15",
    "headway + 60 m",
    "headway + 150 to 300 m",
    "free flow, headway added",
    "free flow, recorded",
    "vehicle 0 at constant speed",
    "vehicle 1 at constant speed",
    "one between, in the next lane",
    "the leader's leader",
)
"""What is shown. Left out: reversed time, where slow reactions look alike, and headways that recorded pairs have."""


class Variation(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How windows are varied. Fluctuations are the differences of all speeds from the mean speed of the window."""

    mirrored: float = 0.5
    """Share of windows whose fluctuations change their sign."""
    scale: tuple[float, float] = (0.6, 1.5)
    """Factor on the fluctuations, log-uniform."""
    faster: float = 15.0
    """Up to so much is added to all speeds of half of the windows [m/s]."""
    time_gap: float = 1.2
    """Headways grow by what is added times this [s]."""
    noise: tuple[float, float] = (0.003, 0.1)
    """Standard deviation of noise on speeds [m/s], log-uniform."""
    least_gap: float = 0.8
    """[m]"""


class ContrastSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Windows and updates of the contrastive teaching."""

    encoder: PairEncoderConfig = PairEncoderConfig(hidden=32, reads="motion", members=5)
    steps: tuple[int, ...] = (31, 61)
    """Lengths of windows [states]; 31 are 6 s."""
    shares: tuple[float, ...] = (0.7, 0.3)
    """How often each length is shown."""
    shortest: float = 0.8
    """Windows are cut to this share of their length or more."""
    stride: int = 2
    """Steps from one window of the same vehicles to the next."""
    copies: int = 12
    """Windows of strangers per recorded window."""
    strangers: float = 0.5
    """Share of strangers among the broken windows."""
    different_lanes: float = 0.15
    """Share of vehicles in different lanes."""
    leaders_leader: float = 0.12
    """Share of pairs without the vehicle between them; the other kinds have equal shares of the rest."""
    variation: Variation = Variation()
    updates: int = 800
    """Of each member."""
    batch: int = 48
    """Pairs, and as many triples."""
    rate: float = 3e-3


@dataclass(frozen=True)
class WeightedWindows:
    """Windows of one length and one number of vehicles."""

    windows: Reactions
    weight: Float[Tensor, " S"]
    """Relative probability of each window in a batch."""
    share: float
    """How often a batch is of these windows and not of another length."""


def contrast_windows(
    sites: Sequence[Site], settings: ContrastSettings, split: str = "train", fold: int = 0
) -> list[list[WeightedWindows]]:
    """Windows for teaching: for pairs and for triples, those of each length that the recordings have.

    Half of the probability is that of recorded windows. Each site counts by the square root of its windows, so that a
    long recording does not drown a short one.

    Errors: `InputError` if the sites have no window of some number of vehicles.
    """
    found = []
    for vehicles in VEHICLES:
        lengths = zip(settings.steps, settings.shares, strict=True)
        parts = [_weighted(sites, vehicles, steps, share, settings, split, fold) for steps, share in lengths]
        found.append([part for part in parts if part is not None])
        if not found[-1]:
            raise InputError(
                f"got recordings in which no {vehicles} vehicles follow each other for {min(settings.steps)} states in"
                f" split {split!r}; give longer recordings, or more of them"
            )
    return found


def _weighted(
    sites: Sequence[Site], vehicles: int, steps: int, share: float, settings: ContrastSettings, split: str, fold: int
) -> WeightedWindows | None:
    made = [
        recorded_following(site, steps, vehicles, split, settings.stride, settings.copies, fold, kinds=KINDS)
        for site in sites
    ]
    by_kind = {kind: [part[kind] for part in made if kind in part] for kind in KINDS}
    by_kind = {kind: parts for kind, parts in by_kind.items() if parts}
    if not {"recorded", "strangers"} <= by_kind.keys():
        return None
    parts_of = {
        "recorded": 1.0,
        "strangers": settings.strangers,
        "different lanes": settings.different_lanes,
        "the leader's leader": settings.leaders_leader,
    }
    others = [kind for kind in by_kind if kind not in parts_of]
    rest = 2 - sum(parts_of.values())
    weight, windows = [], []
    for kind, parts in by_kind.items():
        by_site = torch.cat([torch.full((len(part),), len(part) ** -0.5) for part in parts])
        weight.append(parts_of.get(kind, rest / max(len(others), 1)) * by_site / by_site.sum())
        windows.append(joined(parts))
    weight[0] *= sum(float(part.sum()) for part in weight[1:])  # as much as all broken ones, some of which may lack
    state = torch.cat([part.state for part in windows]).float()
    leader = torch.cat([part.leader for part in windows])
    reactions = Reactions(state[..., 0], state[..., 1], torch.where(leader < 0, UNSEEN, leader))
    return WeightedWindows(reactions, torch.cat(weight), share)
