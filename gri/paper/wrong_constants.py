"""How well graphs are found where the learner's constants are wrong by a factor, before and after it learns them.

The posterior over graphs is measured, not an encoder, with the sparse prior (0.9 for "none") and no mask. The learner
gets the expert's constants times a factor, and neither its units nor its temperature. Beside the accuracy stands the
share of vehicles that "follow" a stranger: vehicle 1 is replaced by the vehicle 1 of another scene, at the same first
headway.
"""

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.graph import pairs
from gri.core.scenes import Scenes
from gri.data.store import DataConfig, Splits, scenes_of
from gri.data.synthetic.idm_drivers import IdmExpert
from gri.data.synthetic.optimal_followers import OptimalExpert
from gri.errors import InputError
from gri.networks.model import RelationalModel
from gri.paper.job_cache import cached
from gri.progress import Progress, no_progress
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.structured import AssumedReward, StructuredReward
from gri.table import markdown_table
from gri.training.grounded.constants_search import ConstantsSearch, search_constants
from gri.training.grounded.reward_likelihood import scene_posterior
from gri.training.grounded.settings import GroundedSettings
from gri.training.train import TrainConfig, model_config

EXPERTS = {
    "policy": DataConfig(range="paper", graphs="one", train=10000, test=1000),
    "noisy": DataConfig(range="paper", graphs="one", train=10000, test=1000, action_noise=0.3),
    "mixed": DataConfig(range="paper", graphs="mixed", train=10000, test=1000),
    "optimal, mixed": DataConfig(range="paper", graphs="mixed", train=200, test=500, expert=OptimalExpert()),
    "idm": DataConfig(range="paper", graphs="one", train=10000, test=1000, expert=IdmExpert()),
}
"""Scenes by name: the paper's expert, the same with noise of 0.3 m/s³ on its jerk, the same on six true graphs, optimal
drivers on six true graphs (no network), and IDM drivers."""
SETTINGS = GroundedSettings(likelihood="stepwise", reward_prior=0.01)
"""Likelihood and priors of the posterior."""


@dataclass(frozen=True)
class Case:
    """What is wrong with the learner's constants, and how it searches."""

    name: str
    factors: dict[str, float] = field(default_factory=dict)
    """Factor on each of the expert's constants; constants that are not named are right."""
    search: ConstantsSearch = field(default_factory=ConstantsSearch)


def _all(factor: float) -> dict[str, float]:
    return dict.fromkeys(FollowingConstants.__struct_fields__, factor)


CASES = (
    Case("the expert's own"),
    Case("all x2", _all(2.0)),
    Case("all x1.5", _all(1.5)),
    Case("all x0.5", _all(0.5)),
    Case("time headway x2", {"time_headway": 2.0}),
    Case("time headway x1.5", {"time_headway": 1.5}),
    Case("standstill headway x2", {"standstill": 2.0}),
    Case("comfort x2", {"comfort": 2.0}),
    Case("wished speed x2", {"speed_limit": 2.0}),
    Case("all x2, one start", _all(2.0), ConstantsSearch(draws=0, rounds=((1, 480),))),
)


def measure(
    seeds: int,
    test_scenes: int,
    cache: Path,
    scenes_folder: Path,
    expert: str | None = None,
    cases: tuple[str, ...] = (),
    finished: bool = False,
    progress: Progress = no_progress,
) -> pd.DataFrame:
    """One line per expert, case and seed. Finished ones are read from `cache`; with `finished`, only those.

    Errors: `InputError` for an unknown expert or case, or where nothing is finished.
    """
    names = [case.name for case in CASES]
    for kind, got, known in (("scenario", [expert] * (expert is not None), list(EXPERTS)), ("row", cases, names)):
        for name in got:
            if name not in known:
                raise InputError(f"got {kind} {name} for constants, wanted one of {', '.join(known)}")
    experts = {name: data for name, data in EXPERTS.items() if expert in (None, name)}
    chosen = [case for case in CASES if not cases or case.name in cases]
    wanted = [(name, case, seed) for seed in range(seeds) for name in experts for case in chosen]
    lines = []
    for count, (name, case, seed) in enumerate(wanted):
        data = msgspec.structs.replace(experts[name], test=test_scenes)
        content = [data, data.scene_range, data.shares, asdict(case), SETTINGS, seed]

        def compute(data: DataConfig = data, case: Case = case, seed: int = seed) -> dict[str, Any]:
            if finished:
                raise _NotFinishedError
            return measure_case(data, case, seed, scenes_folder)

        try:
            result = cached(cache, f"constants-{name.replace(', ', '-')}", content, compute)
        except _NotFinishedError:
            continue
        lines.append({"expert": name, "constants": case.name, "seed": seed} | result)
        progress("constants", count + 1, len(wanted), 0.0)
    if not lines:
        raise InputError(f"got --finished, but nothing is finished in {cache}; leave it out to train")
    return pd.DataFrame(lines)


class _NotFinishedError(Exception):
    pass


def measure_case(data: DataConfig, case: Case, seed: int, scenes_folder: Path) -> dict[str, Any]:
    """Accuracy and followed strangers before and after the search, and what was learned."""
    torch.set_num_threads(1)
    splits = scenes_of(data, scenes_folder)
    true = data.scene_range.reward.constants
    assert isinstance(true, FollowingConstants), "got a range of lane changes, wanted car following"
    first = {name: getattr(true, name) * case.factors.get(name, 1.0) for name in true.__struct_fields__}
    assumed = AssumedReward(constants=FollowingConstants(**first))
    torch.manual_seed(seed)
    model = RelationalModel(model_config(TrainConfig(name="constants", data=data, objective=SETTINGS, reward=assumed)))
    reward, began = StructuredReward(assumed), time.process_time()
    before = _scores(model, reward, splits, "untrained")
    generator = torch.Generator().manual_seed(seed)
    search_constants(model, reward, splits.train, case.search, SETTINGS.reward_prior, SETTINGS.no_edge_prior, generator)
    assert reward.constants is not None
    learned = {f"learned_{name}": value for name, value in reward.constants.values().items()}
    after = _scores(model, reward, splits, "trained")
    spent = {"cpu_seconds": round(time.process_time() - began, 1)}
    return before | after | {"empty_graph": float((splits.test.graph == 0).float().mean())} | learned | spent


def _scores(model: RelationalModel, reward: StructuredReward, splits: Splits, stage: str) -> dict[str, float]:
    posterior = scene_posterior(model, reward, splits.test, SETTINGS)
    accuracy = float((posterior.argmax(-1) == splits.test.graph).float().mean())
    follows = follows_vehicle_1(splits.test)
    strangers = scene_posterior(model, reward, with_strangers(splits.test[follows]), SETTINGS)
    followed = strangers[:, pairs(3).index((1, 0))].argmax(-1) > 0
    return {f"{stage}_accuracy": accuracy, f"{stage}_stranger_followed": float(followed.float().mean())}


def follows_vehicle_1(scenes: Scenes) -> Tensor:
    """Indices of the scenes in which 0 follows 1."""
    return (scenes.graph[:, pairs(3).index((1, 0))] > 0).nonzero()[:, 0]


def with_strangers(scenes: Scenes) -> Scenes:
    """The scenes with vehicle 1 replaced by that of the next scene, moved to the same first headway."""
    state, action = scenes.state.clone(), scenes.action.clone()
    stranger: Float[Tensor, "S T D"] = scenes.state[:, 1].roll(1, 0).clone()
    stranger[..., 0] += scenes.state[:, 1, :1, 0] - stranger[:, :1, 0]
    state[:, 1], action[:, 1] = stranger, scenes.action[:, 1].roll(1, 0)
    return Scenes(state, action, scenes.graph)


NOTES = """\
Accuracy [%] of the most probable types of the posterior over all six edges: mean over seeds [lowest, highest]. The
learner's constants are the expert's times the factor; its units and its temperature are 1 whatever the expert's are.
"Strangers": share of scenes [%] in which vehicle 0 follows a vehicle 1 from another scene. Learned: mean over seeds.
"""


def page(frame: pd.DataFrame) -> str:
    """The tables as Markdown, one per expert."""
    parts = ["# Wrong constants\n", NOTES]
    for expert, data in EXPERTS.items():
        ours = frame[frame["expert"] == expert]
        if not len(ours):
            continue
        true = data.scene_range.reward.constants
        assert isinstance(true, FollowingConstants)
        header = ["constants", "untrained", "trained", "strangers, untrained", "strangers, trained"]
        header += [*(f"learned {name} (true {getattr(true, name):g})" for name in SHOWN), "seeds", "CPU s"]
        if isinstance(data.expert, IdmExpert):
            header = [title.partition(" (true")[0] for title in header]  # IDM drivers have none of these constants
        cells = [_cells(case.name, ours[ours["constants"] == case.name]) for case in CASES]
        empty = ["empty graph", f"{100 * ours['empty_graph'].iloc[0]:.1f}", *["–"] * (len(header) - 2)]
        parts += [f"## {expert}\n", markdown_table(header, [*(line for line in cells if line), empty])]
    return "\n".join(parts)


SHOWN = ("time_headway", "standstill", "comfort", "speed_limit")
"""Constants that are printed."""


def _cells(name: str, part: pd.DataFrame) -> list[str]:
    if not len(part):
        return []
    scores = [
        f"{100 * part[column].mean():.1f} [{100 * part[column].min():.1f}, {100 * part[column].max():.1f}]"
        for stage in ("accuracy", "stranger_followed")
        for column in (f"untrained_{stage}", f"trained_{stage}")
    ]
    learned = [f"{part[f'learned_{constant}'].mean():.2f}" for constant in SHOWN]
    return [name, *scores, *learned, str(len(part)), f"{part['cpu_seconds'].mean():.0f}"]
