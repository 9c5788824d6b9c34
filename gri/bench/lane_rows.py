"""The rows of the lane benchmark: from trivial answers to a network that is taught the relations of every step.

A row turns scenes into probabilities of the four edge types for every ordered pair and step.
"""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gri import checkpoint
from gri.bench.lane_classifier import MOST, See, Size, first_frame, train_step_classifier
from gri.bench.lane_families import FIRST
from gri.bench.lane_scenes import (
    FOLLOW,
    LAG,
    LEADER,
    MERGER,
    NONE,
    YIELD,
    LaneScenes,
    balanced_steps,
    joined,
    pairs_that_may_react,
    role_pairs,
)
from gri.bench.resumable_jobs import Row
from gri.core.edges import LANE_CHANGING, pairs
from gri.networks.model import RelationalModel
from gri.relations.closed_form_posterior import Explanations, Weights, explain, follow_probabilities

TYPES = len(LANE_CHANGING)
UPDATES, FRAME_UPDATES = 600, 400  # of the classifiers that are taught series, and single frames
WINDOW = 25  # frames that the closed form sees
STRIDE = 10  # steps between two evaluations of the closed form
Infer = Callable[[LaneScenes], Float[Tensor, "S T E K"]]
LaneRow = Row[LaneScenes, Tensor]


def _empty(scenes: LaneScenes) -> Float[Tensor, "S T E K"]:
    """Certainly no relation."""
    p = torch.zeros(*scenes.relations.shape, TYPES, dtype=torch.float64)
    p[..., NONE] = 1.0
    return p


def _same_lane(scenes: LaneScenes, i: int, j: int) -> Tensor:
    y = scenes.state[..., 1] / scenes.lane_width[:, None, None]
    return (y[:, i] > -0.5) == (y[:, j] > -0.5)


def _prior(scenes: LaneScenes) -> Float[Tensor, "S T E K"]:
    """Lanes and order alone, without motion: a vehicle follows the next one ahead in its lane, with P = .7.

    For the next one ahead in the other lane, follow and yield have .15 each.
    """
    p, x, n = _empty(scenes), scenes.state[..., 0], len(scenes.roles)
    for edge, (i, j) in enumerate(pairs(n)):
        ahead, same = x[:, i] > x[:, j], _same_lane(scenes, i, j)
        between = torch.zeros_like(ahead)
        for k in set(range(n)) - {i, j}:
            between |= (x[:, k] > x[:, j]) & (x[:, k] < x[:, i]) & (_same_lane(scenes, k, j) == same)
        nearest = ahead & ~between
        p[..., edge, FOLLOW] = torch.where(nearest, torch.where(same, 0.7, 0.15), 0.0)
        p[..., edge, YIELD] = torch.where(nearest & ~same, 0.15, 0.0)
        p[..., edge, NONE] = 1 - p[..., edge, FOLLOW] - p[..., edge, YIELD]
    return p


def _frequencies(scenes: LaneScenes, kinds: Sequence[str]) -> dict[tuple[str, str], Float[Tensor, " K"]]:
    """How often each type occurs between two roles in the scored steps of scenes of these kinds, plus one."""
    edges = pairs_that_may_react(scenes.roles)
    scored = balanced_steps(scenes.relations, edges, FIRST, MOST, seed=0)
    rows = torch.tensor([kind in kinds for kind in scenes.kind])
    found = {}
    for edge in edges:
        types = scenes.relations[rows][..., edge][scored[rows][..., edge]]
        counts = torch.bincount(types, minlength=TYPES).double()
        found[role_pairs(scenes.roles)[edge]] = (counts + 1) / (counts.sum() + TYPES)
    return found


def _constant(told_kind: bool) -> Callable[[Sequence[LaneScenes], Sequence[LaneScenes], int], Infer]:
    def prepare(train: Sequence[LaneScenes], validation: Sequence[LaneScenes], seed: int) -> Infer:
        del validation, seed
        every = joined(train)
        kinds = sorted(set(every.kind))
        table = {kind: _frequencies(every, (kind,) if told_kind else kinds) for kind in kinds}
        pooled = _frequencies(every, kinds)

        def infer(scenes: LaneScenes) -> Float[Tensor, "S T E K"]:
            p = _empty(scenes)
            for scene, kind in enumerate(scenes.kind):
                for edge, pair in enumerate(role_pairs(scenes.roles)):
                    shares = table.get(kind, pooled).get(pair)  # a kind that no training scene has: pooled
                    if shares is not None:
                        p[scene, :, edge] = shares
            return p

        return infer

    return prepare


def _rule(scenes: LaneScenes) -> Float[Tensor, "S T E K"]:
    """The textbook merge, whatever moves: the merger follows the leader and cuts in; the lag vehicle yields to it."""
    p = _empty(scenes)
    meant = {(LEADER, MERGER): "follow", (LAG, MERGER): "cut_in", (MERGER, LAG): "yield"}
    for edge, pair in enumerate(role_pairs(scenes.roles)):
        if pair in meant:
            p[..., edge, :] = torch.eye(TYPES, dtype=p.dtype)[[str(kind) for kind in LANE_CHANGING].index(meant[pair])]
    return p


def _model(model: RelationalModel) -> Infer:
    """Types by an encoder at every step, from the last states that it wants to see; "none" before there are enough."""

    @torch.no_grad()
    def infer(scenes: LaneScenes) -> Float[Tensor, "S T E K"]:
        p = _empty(scenes)
        for step in range(model.history_steps - 1, scenes.relations.shape[1]):
            seen = scenes.state[:, :, step + 1 - model.history_steps : step + 1]
            x = seen[..., :1] - seen[:, :1, -1:, :1]  # small positions keep the digits of float32
            p[:, step] = model.infer(torch.cat([x, seen[..., 1:]], -1).float()).probs.double()
        return p

    return infer


def _untrained(train: Sequence[LaneScenes], validation: Sequence[LaneScenes], seed: int) -> Infer:
    torch.manual_seed(seed)
    return _model(RelationalModel(checkpoint.load("us101_merge").config).eval())


def _closed_form(train: Sequence[LaneScenes], validation: Sequence[LaneScenes], seed: int) -> Infer:
    """Car following only; weights of its explanations from the training scenes, without their relations."""
    del validation
    few = joined([part[torch.arange(min(100, len(part)))] for part in train])
    weights = _explained(few, (FIRST + few.relations.shape[1]) // 2, seed).weights()
    return lambda scenes: _closed_form_of(scenes, weights, seed)


def _explained(scenes: LaneScenes, step: int, seed: int) -> Explanations:
    seen = scenes.state[:, :, step + 1 - WINDOW : step + 1]
    return explain(seen[..., 0], seen[..., 2], scenes.dt, float(scenes.length.mean()), others=4, seed=seed)


def _closed_form_of(scenes: LaneScenes, weights: Weights, seed: int) -> Float[Tensor, "S T E K"]:
    p, steps = _empty(scenes), scenes.relations.shape[1]
    for step in range(WINDOW - 1, steps, STRIDE):
        follow = follow_probabilities(_explained(scenes, step, seed).posterior(weights))
        p[:, step : step + STRIDE, :, FOLLOW] = follow[:, None]
        p[:, step : step + STRIDE, :, NONE] = 1 - follow[:, None]
    return p


def _taught(see: See, over_time: bool) -> Callable[[Sequence[LaneScenes], Sequence[LaneScenes], int], Infer]:
    size = Size(UPDATES if over_time else FRAME_UPDATES, over_time=over_time)
    return lambda train, _, seed: train_step_classifier(train, see, seed, size)


def _released(name: str, given: str) -> LaneRow:
    return LaneRow(f"released: {name}", given, lambda *_: _model(checkpoint.load(name)))


LANE_ROWS: tuple[LaneRow, ...] = (
    LaneRow("nobody reacts", "nothing", lambda *_: _empty),
    LaneRow("textbook merge", "nothing", lambda *_: _rule),
    LaneRow("prior: lanes and order", "nothing", lambda *_: _prior),
    LaneRow("most frequent per pair", "labels", _constant(told_kind=False)),
    LaneRow("most frequent per pair and kind", "labels, kind of scene", _constant(told_kind=True)),
    LaneRow("untrained encoder", "nothing", _untrained),
    LaneRow("geometry of the first frame", "labels", _taught(first_frame, over_time=False), varies=True),
    LaneRow("geometry of the last frame", "labels", _taught(lambda scenes: scenes, over_time=False), varies=True),
    _released("us101_merge", "no labels"),
    _released("mixed_merge", "labels (SUMO's)"),
    LaneRow("closed form, follow only", "no labels", _closed_form),
    LaneRow("labelled classifier (ceiling)", "labels", _taught(lambda scenes: scenes, over_time=True), varies=True),
)
