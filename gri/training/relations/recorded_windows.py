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


def recorded_windows(paths: Sequence[Path], steps: int) -> tuple[Reactions, Float[Tensor, "K 3 T 3"]]:
    """Windows of the training split, half of them as recorded, and the states of the recorded ones.

    Errors: `InputError` as in `recorded_pairs`.
    """
    windows = recorded_pairs(paths, steps)
    recorded = windows.kind == "recorded"
    kinds = [np.flatnonzero(windows.kind == kind) for kind in sorted(set(windows.kind[~recorded]))]
    rng, share = np.random.default_rng(0), int(recorded.sum()) // max(len(kinds), 1)
    broken = np.concatenate([rng.choice(rows, share, replace=len(rows) < share) for rows in kinds])
    rows = torch.from_numpy(np.concatenate([np.flatnonzero(recorded), broken]))
    state, leader = windows.state[rows].float(), windows.leader[rows]
    known = windows.state[torch.from_numpy(np.flatnonzero(recorded))].float()
    return Reactions(state[..., 0], state[..., 1], torch.where(leader < 0, UNSEEN, leader)), known
