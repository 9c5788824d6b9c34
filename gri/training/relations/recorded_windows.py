"""Windows of recorded car following, and windows broken on purpose, for contrastive teaching.

That each recorded vehicle follows the next one is a hypothesis, and it is the only thing assumed. In the broken windows
(strangers, other lanes, stretched headways, free flow; `gri.data.ngsim.following_triples`) no vehicle can react to
another one, whatever drivers do.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gri.data.ngsim.following_triples import recorded_pairs
from gri.relations.reaction_scenes import UNSEEN, Reactions

LEFT_OUT = ("time reversed",)  # slow reactions look alike in both directions
STRANGERS = 0.4  # share of the broken windows; the other kinds have equal shares


def recorded_windows(paths: Sequence[Path], steps: int) -> tuple[Reactions, Float[Tensor, "K 3 T 3"]]:
    """Windows of the training split, half of them as recorded, and the states of the recorded ones.

    Errors: `InputError` as in `recorded_pairs`.
    """
    windows = recorded_pairs(paths, steps, stride=2, copies=4)
    recorded = np.flatnonzero(windows.kind == "recorded")
    kinds = sorted(set(windows.kind) - {"recorded", *LEFT_OUT})
    rng, broken = np.random.default_rng(0), []
    for kind in kinds:
        share = STRANGERS if kind == "strangers" else (1 - STRANGERS) / max(len(kinds) - 1, 1)
        rows, count = np.flatnonzero(windows.kind == kind), round(share * len(recorded))
        broken.append(rng.choice(rows, count, replace=len(rows) < count))
    rows = torch.from_numpy(np.concatenate([recorded, *broken]))
    state, leader = windows.state[rows].float(), windows.leader[rows]
    known = windows.state[torch.from_numpy(recorded)].float()
    return Reactions(state[..., 0], state[..., 1], torch.where(leader < 0, UNSEEN, leader)), known
