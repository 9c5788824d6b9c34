"""The test sets of the lane benchmark: six driver models, scenes with two vehicles, and controls.

Splits are fixed by their seeds: everybody who runs the benchmark meets the same scenes.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from gri.bench.driver_models import DRIVER_MODELS, DriverModel
from gri.bench.lane_scenes import LAG, LEADER, NONE, LaneScenes, joined
from gri.bench.lane_simulation import CONTACT_WIDTH, KINDS, LaneFamily, draw_lane_scenes

LANES = LaneFamily("lanes")
SHARES = dict(zip(KINDS, (0.40, 0.25, 0.20, 0.15), strict=True))
"""Of the kinds of scenes, after scenes with a contact are thrown away."""
SPLIT_SEEDS = {"train": 11_000, "validation": 12_000, "test": 13_000, "variants": 14_000, "controls": 15_000}
FIRST = 24  # the first scored step: every row has seen 5 s


@dataclass(frozen=True)
class LaneTest:
    """Scenes with known relations, and what they are a test of."""

    name: str
    kind: str
    """"drivers", "variant" (one vehicle is not in the scene), or "control" (no relation with the merger)."""
    scenes: LaneScenes


def counts(total: int) -> dict[str, int]:
    """Scenes of each kind, `total` in all."""
    found = {kind: int(share * total) for kind, share in SHARES.items()}
    found[KINDS[0]] += total - sum(found.values())
    return found


def lane_split(part: str, model: DriverModel, total: int) -> LaneScenes:
    """Scenes of one driver model out of a fixed split: "train", "validation", "test" or "variants"."""
    return draw_lane_scenes(LANES, model, counts(total), _seed(part, model))


def lane_tests(total: int) -> list[LaneTest]:
    """All test sets with `total` scenes each, or a few more."""
    drivers = [LaneTest(model.name, "drivers", lane_split("test", model, total)) for model in DRIVER_MODELS]
    each = -(-total // len(DRIVER_MODELS))
    mixed = joined([lane_split("variants", model, each) for model in DRIVER_MODELS])
    variants = [
        LaneTest("lag vehicle only", "variant", mixed.without(LEADER)),
        LaneTest("leader only", "variant", mixed.without(LAG)),
    ]
    return [*drivers, *variants, *_controls(each)]


def _seed(part: str, model: DriverModel) -> int:
    return SPLIT_SEEDS[part] + [known.name for known in DRIVER_MODELS].index(model.name)


def _controls(each: int) -> list[LaneTest]:
    """Scenes in which no vehicle reacts to the merger, nor the merger to anybody of the scene."""
    merge, _, change, keeper = KINDS
    wanted = {keeper: each, change: each, merge: 2 * each}
    drawn = joined([draw_lane_scenes(LANES, model, wanted, _seed("controls", model)) for model in DRIVER_MODELS])
    of = {name: torch.tensor([row for row, kind in enumerate(drawn.kind) if kind == name]) for name in wanted}
    return [
        LaneTest("lane keeper beside a gap", "control", drawn[of[keeper]]),
        LaneTest("change without relation", "control", drawn[of[change]]),
        LaneTest("strangers", "control", strangers(drawn[of[merge]], each * len(DRIVER_MODELS))),
    ]


def strangers(scenes: LaneScenes, count: int) -> LaneScenes:
    """Three vehicles of three merges, matched by mean speed, with the first places of one of them; at most `count`.

    The lateral motion is kept, in lane widths. Scenes in which vehicles touch are left out.
    """
    order = scenes.state[..., 2].mean((1, 2)).argsort()
    found: list[LaneScenes] = []
    for shift in range(1, len(order) // 2):
        rows = [order, order.roll(shift), order.roll(-shift)]
        state = torch.stack([_placed(scenes, row, order, vehicle) for vehicle, row in enumerate(rows)], 1)
        mean = state[..., 2].mean(-1)
        near = (mean - mean[:, :1]).abs().amax(1) < 1.0
        fine = (near & ~_touch(state)).nonzero()[:, 0]
        mixed = replace(scenes[order], state=state, relations=torch.full_like(scenes.relations, NONE))
        found.append(replace(mixed, kind=("strangers",) * len(mixed))[fine])
        if sum(map(len, found)) >= count:
            break
    every = joined(found)
    return every[torch.arange(min(count, len(every)))]


def _placed(scenes: LaneScenes, row: Tensor, at: Tensor, vehicle: int) -> Tensor:
    """The states of a vehicle of other scenes, put where this vehicle begins in the scenes `at`."""
    state = scenes.state[row, vehicle].clone()
    state[..., 0] += (scenes.state[at, vehicle, 0, 0] - state[:, 0, 0])[:, None]
    state[..., 1] *= (scenes.lane_width[at] / scenes.lane_width[row])[:, None]
    return state


def _touch(state: Tensor) -> Tensor:
    touching = torch.zeros(len(state), dtype=torch.bool)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        along, across = ((state[:, i, :, d] - state[:, j, :, d]).abs() for d in (0, 1))
        touching |= ((along < 5.3) & (across < CONTACT_WIDTH)).any(-1)
    return touching
