"""The test sets of the benchmark: simulated scenes of six driver models, and controls in which nobody can react.

A third kind are unknown worlds: nothing like them is among the training scenes, so that a row should trust itself less.

Splits are fixed by their seeds: everybody who runs the benchmark meets the same scenes. The learner may see the states
of the training split, never its relations, unless a row says that it is taught with labels.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from gri.bench.car_following_scenes import (
    DT,
    OWN,
    KnownScenes,
    SceneFamily,
    accelerations,
    draw_scenes,
    is_free_of_contact,
)
from gri.bench.driver_models import DRIVER_MODELS, IDM, DriverModel

NEAR = SceneFamily("near", headway=(10.0, 50.0))
WIDE = SceneFamily("wide")
SPLIT_SEEDS = {"train": 1_000, "validation": 2_000, "test": 5_000}


@dataclass(frozen=True)
class TestSet:
    """Scenes with known relations, and what they are a test of."""

    __test__ = False  # no test class of pytest

    name: str
    kind: str
    """"drivers", "control" (no edge is there) or "unknown" (a world that no row was made for)."""
    scenes: KnownScenes


def split(part: str, model: DriverModel, family: SceneFamily, count: int) -> KnownScenes:
    """Scenes of one driver model out of a fixed split: "train", "validation" or "test"."""
    names = [known.name for known in DRIVER_MODELS]
    return draw_scenes(family, model, count, SPLIT_SEEDS[part] + 10 * names.index(model.name) + (family.name == "wide"))


def test_sets(count: int) -> list[TestSet]:
    """All test sets with `count` scenes each."""
    drivers = [
        TestSet(f"{model.name}, {family.name}", "drivers", split("test", model, family, count))
        for family in (NEAR, WIDE)
        for model in DRIVER_MODELS
    ]
    others = {"control": controls(count), "unknown": unknown_worlds(count)}
    return drivers + [TestSet(name, kind, scenes) for kind, sets in others.items() for name, scenes in sets.items()]


def controls(count: int) -> Mapping[str, KnownScenes]:
    """Scenes in which no vehicle reacts to another one of the scene."""
    seed = SPLIT_SEEDS["test"] + 500
    chains = split("test", IDM, NEAR, 4 * count)
    following = _where_everybody_follows_the_next(chains, count)
    return {
        "own speeds": draw_scenes(replace(NEAR, follows=0.0, unseen=0.0), IDM, count, seed),
        "unseen leaders": draw_scenes(replace(NEAR, follows=0.0, unseen=1.0), IDM, count, seed + 1),
        "free flow": draw_scenes(
            replace(WIDE, headway=(60.0, 155.0), speed=(20.0, 33.0), follows=0.0, unseen=0.0), IDM, count, seed + 2
        ),
        "strangers": _strangers(chains, count),
        "headway x 4": _stretched(following, 4.0),
        "headway x 15": _stretched(following, 15.0),
        "time reversed": _reversed(following),
    }


def unknown_worlds(count: int) -> Mapping[str, KnownScenes]:
    """Speeds, spacings, drivers and sensors unlike those of all training scenes."""
    seed = SPLIT_SEEDS["test"] + 700
    usual = draw_scenes(NEAR, IDM, count, seed)
    return {
        "fast": draw_scenes(replace(NEAR, speed=(40.0, 60.0)), IDM, count, seed + 1),
        "far apart": draw_scenes(replace(NEAR, headway=(250.0, 500.0)), IDM, count, seed + 2),
        "oscillating": _moved_by(_oscillating, count, seed + 3),
        "random walk": _moved_by(_random_walk, count, seed + 4),
        "slow motion": _every_second(draw_scenes(replace(NEAR, steps=2 * NEAR.steps - 1), IDM, count, seed + 5)),
        "position noise": _with_position_noise(usual, 1.0, seed + 6),
        "trucks": draw_scenes(replace(NEAR, length=20.0, headway=(25.0, 65.0)), IDM, count, seed + 7),
    }


def _moved_by(speeds: Callable[[Tensor, torch.Generator], Tensor], count: int, seed: int) -> KnownScenes:
    """Vehicles that react to nothing: starts of `NEAR`, speeds over time [S, N, T] from the first speeds [S, N, 1]."""
    generator = torch.Generator().manual_seed(seed)
    start = draw_scenes(NEAR, IDM, 5 * count, seed).state[:, :, :1]
    v = speeds(start[..., 1], generator).clamp(min=0)
    a = torch.zeros_like(v)
    a[..., 1:] = accelerations(v)
    x = start[..., 0] + torch.nn.functional.pad(((v[..., 1:] + v[..., :-1]) / 2 * DT).cumsum(-1), (1, 0))
    state = torch.stack([x, v, a], -1)
    fine = is_free_of_contact(state)
    assert int(fine.sum()) >= count, f"got {int(fine.sum())} scenes without contact, wanted {count}; draw more"
    return _nobody(state[fine][:count], float(fine.double().mean()))


def _oscillating(v: Float[Tensor, "S N 1"], generator: torch.Generator) -> Float[Tensor, "S N T"]:
    """Every vehicle has an amplitude (1–4 m/s), a period (2–6 s) and a phase of its own."""
    amplitude, period, phase = (torch.rand((3, *v.shape), generator=generator, dtype=v.dtype)).unbind(0)
    time = DT * torch.arange(NEAR.steps)
    return v + (1 + 3 * amplitude) * torch.sin(2 * torch.pi * (time / (2 + 4 * period) + phase))


def _random_walk(v: Float[Tensor, "S N 1"], generator: torch.Generator) -> Float[Tensor, "S N T"]:
    """Accelerations are white: 3 m/s² of standard deviation in every step, as of no driver."""
    steps = 3.0 * DT * torch.randn((*v.shape[:2], NEAR.steps), generator=generator, dtype=v.dtype)
    return v + steps.cumsum(-1)


def _every_second(scenes: KnownScenes) -> KnownScenes:
    """States 0.4 s apart that say they are 0.2 s apart."""
    return KnownScenes(scenes.state[:, :, ::2], scenes.leader, scenes.acceptance)


def _with_position_noise(scenes: KnownScenes, sd: float, seed: int) -> KnownScenes:
    """White noise on positions alone [m]; speeds stay."""
    state = scenes.state.clone()
    noise = torch.randn(state.shape[:3], generator=torch.Generator().manual_seed(seed), dtype=state.dtype)
    state[..., 0] += sd * noise
    return KnownScenes(state, scenes.leader, scenes.acceptance)


def _where_everybody_follows_the_next(scenes: KnownScenes, count: int) -> KnownScenes:
    """Chains; where there are too few, those in which the last vehicle follows the next one."""
    chain = (scenes.leader[:, 0] == 1) & (scenes.leader[:, 1] == 2)
    rest = (scenes.leader[:, 0] == 1) & ~chain
    rows = torch.cat([chain.nonzero()[:, 0], rest.nonzero()[:, 0]])[:count]
    return KnownScenes(scenes.state[rows], scenes.leader[rows], scenes.acceptance)


def _nobody(state: Float[Tensor, "S N T 3"], acceptance: float) -> KnownScenes:
    return KnownScenes(state, torch.full(tuple(state.shape[:2]), OWN), acceptance)


def _stretched(scenes: KnownScenes, factor: float) -> KnownScenes:
    """Every first headway times a factor. Speeds stay: the follower reacts at a distance that makes no sense."""
    state = scenes.state.clone()
    headway = state[:, 1:, 0, 0] - state[:, :-1, 0, 0]
    added = torch.cat([torch.zeros_like(headway[:, :1]), (headway * (factor - 1)).cumsum(1)], 1)
    state[..., 0] += added[..., None]
    return _nobody(state, scenes.acceptance)


def _strangers(scenes: KnownScenes, count: int) -> KnownScenes:
    """Three vehicles of three scenes, matched by mean speed, with the first headways of a real scene.

    Scenes in which they would touch are left out.
    """
    state = scenes.state
    mean = state[:, 0, :, 1].mean(-1)
    order = mean.argsort()
    found = []
    for shift in range(1, len(order) // 2):
        rows, second, third = order, order.roll(shift), order.roll(-shift)
        mixed = torch.stack([state[rows, 0], state[second, 1], state[third, 2]], 1)
        mixed[..., 0] += (state[rows, :, 0, 0] - mixed[:, :, 0, 0])[..., None]
        near = (mixed[..., 1].mean(-1) - mixed[:, :1, :, 1].mean(-1)).abs().amax(1) < 1.0
        apart = ((mixed[:, 1:, :, 0] - mixed[:, :-1, :, 0]) > 5.3).all(-1).all(-1)
        found.append(mixed[near & apart])
        if sum(map(len, found)) >= count:
            break
    return _nobody(torch.cat(found)[:count], scenes.acceptance)


def _reversed(scenes: KnownScenes) -> KnownScenes:
    """The film played backwards and turned round, so that vehicles drive forwards: effects come before their causes.

    The order along the road is turned round as well; vehicle N−1 is the foremost again.
    """
    x, v, _ = scenes.state.flip(2).flip(1).unbind(-1)
    x = x.max() - x
    a = torch.zeros_like(v)
    a[..., 1:] = accelerations(v)
    return _nobody(torch.stack([x, v, a], -1), scenes.acceptance)
