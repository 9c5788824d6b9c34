"""Who follows whom at a site that nothing was taught on: encoders as that of `ngsim_relations`, taught on another site.

    python benchmarks/recorded_across_sites.py us-101.csv.gz i-80.csv.gz

For each ordered pair of sites: the encoder is taught on all vehicles of the training split of the one and tested on all
vehicles of the other. Beside it: the greatest lagged correlation of speeds, which nothing was taught either, and
`us101_car_following`, which saw no recording. AUC of recorded windows against strangers, with 95 % clustered by the
following vehicle.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from gri import checkpoint
from gri.bench.car_following_scenes import DT
from gri.bench.recorded_rows import speed_correlation
from gri.bench.recorded_scores import ranking
from gri.bench.recorded_sets import COPIES, FOLDS, STEPS, STRIDE, VEHICLES, as_scenes
from gri.core.edges import pairs
from gri.data.ngsim.following_triples import Site, read_sites, recorded_following
from gri.data.ngsim.following_windows import FollowingWindows, joined
from gri.networks.pair_encoder import PairEncoder
from gri.training.relations.recorded_windows import ContrastSettings, contrast_windows
from gri.training.relations.teach_recorded import teach_recorded_encoder

KINDS = ("recorded", "strangers")
FEW = 20  # windows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, nargs="+", help="NGSIM files of two sites or more")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    torch.set_num_threads(1)
    sites, settings = read_sites(given.recordings), ContrastSettings()
    released = checkpoint.load("us101_car_following").encoder
    assert isinstance(released, PairEncoder)
    for taught_on in sites:
        encoder = PairEncoder(settings.encoder, 1, DT)
        teach_recorded_encoder(encoder, contrast_windows([taught_on], settings), settings, given.seed)
        for tested_on in sites:
            if tested_on is not taught_on:
                print(f"\ntaught on {taught_on.name}, tested on {tested_on.name}", flush=True)
                _score(tested_on, {"taught elsewhere": encoder, "us101_car_following": released})


def _score(site: Site, encoders: dict[str, PairEncoder]) -> None:
    for vehicles, count in VEHICLES.items():
        for window, steps in STEPS.items():
            found = [tested(site, steps, count, kind) for kind in KINDS]
            if any(sum(map(len, parts)) < FEW for parts in found):
                continue
            parts = [joined(each) for each in found]
            edges = [e for e, (i, j) in enumerate(pairs(count)) if i == j + 1]
            rows = {"lagged correlation of speeds": [speed_correlation(as_scenes(part))[:, edges] for part in parts]}
            for name, encoder in encoders.items():
                rows[name] = [follow(encoder, part)[:, edges] for part in parts]
            cluster = np.concatenate([np.repeat(part.vehicle[:, 0].numpy(), len(edges)) for part in parts])
            truth = np.repeat([True, False], [len(part) * len(edges) for part in parts])
            for name, p in rows.items():
                score = ranking(torch.cat([part.flatten() for part in p]).double().numpy(), truth, cluster)
                print(
                    f"{vehicles}, {window} ({len(parts[0])} and {len(parts[1])} windows) {name:30s}"
                    f" {score.value:.2f} ({score.low:.2f}-{score.high:.2f})",
                    flush=True,
                )


def tested(site: Site, steps: int, vehicles: int, kind: str) -> Sequence[FollowingWindows]:
    """Windows of the five test parts, which together have every vehicle once."""
    found = [
        recorded_following(site, steps, vehicles, "test", STRIDE["test"], COPIES, fold, kinds=KINDS).get(kind)
        for fold in range(FOLDS)
    ]
    return [part for part in found if part is not None]


@torch.no_grad()
def follow(encoder: PairEncoder, windows: FollowingWindows) -> torch.Tensor:
    """P(follow) of each ordered pair [S, E]."""
    p = encoder.explanations(windows.state[..., :2].float())[..., 2:]
    return torch.stack([p[:, j, i] for i, j in pairs(p.shape[1])], 1)


if __name__ == "__main__":
    main()
