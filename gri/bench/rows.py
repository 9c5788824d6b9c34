"""The rows of the benchmark: from trivial answers to a network that is taught the relations.

A row turns scenes into P(follow) of every ordered pair. Each says what it was given: nothing, states only ("no
labels"), or relations of other scenes ("labels").
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gri import checkpoint
from gri.bench import resumable_jobs
from gri.bench.answers import Answer, Infer, Score, observed
from gri.bench.car_following_scenes import DT, LENGTH, WINDOW, KnownScenes, accelerations
from gri.bench.pair_classifier import train_classifier
from gri.bench.pcmci_row import pcmci
from gri.bench.reconstruction_rows import nri, per_step
from gri.bench.reward_rows import fitted_reward, taught_encoder, untrained_reward
from gri.bench.structure import with_prior
from gri.core.edges import EdgeType, pairs
from gri.networks.model import RelationalModel
from gri.networks.pair_encoder import PairEncoder
from gri.relations.closed_form_posterior import Weights, explain, follow_probabilities

MOST_LAG = 10  # steps
UPDATES = 1500  # of the taught classifiers
FLAT_PRIOR, STRUCTURED = "flat prior", "prior: one of those ahead"


Row = resumable_jobs.Row[KnownScenes, Answer | Tensor]


def _nobody(scenes: KnownScenes) -> Float[Tensor, "S E"]:
    return torch.zeros(len(scenes), len(pairs(scenes.state.shape[1])), dtype=torch.float64)


def _next_ahead(scenes: KnownScenes) -> Float[Tensor, "S E"]:
    n = scenes.state.shape[1]
    row = torch.tensor([float(i == j + 1) for i, j in pairs(n)], dtype=torch.float64)
    return row.repeat(len(scenes), 1)


def _prior(scenes: KnownScenes) -> Float[Tensor, "S E"]:
    """What the posterior says before it has seen any motion: one of those ahead, with equal odds."""
    n, follow = scenes.state.shape[1], Weights().follow
    row = torch.tensor([follow / (n - 1 - j) if i > j else 0.0 for i, j in pairs(n)], dtype=torch.float64)
    return row.repeat(len(scenes), 1)


def lagged_correlation(scenes: KnownScenes) -> Float[Tensor, "S E"]:
    """Greatest correlation of the sender's acceleration with the receiver's up to 2 s later."""
    a = accelerations(observed(scenes)[..., 1])
    found = []
    for i, j in pairs(a.shape[1]):
        values = []
        for lag in range(MOST_LAG + 1):
            cause, effect = a[:, i, : a.shape[-1] - lag], a[:, j, lag:]
            cause, effect = (part - part.mean(-1, keepdim=True) for part in (cause, effect))
            norm = (cause.square().sum(-1) * effect.square().sum(-1)).sqrt().clamp(min=1e-9)
            values.append((cause * effect).sum(-1) / norm)
        found.append(torch.stack(values).amax(0))
    return torch.stack(found, 1)


def granger(scenes: KnownScenes) -> Float[Tensor, "S E"]:
    """log F of a Granger test: do four past accelerations of the sender add to four of the receiver's own?"""
    a, order = accelerations(observed(scenes)[..., 1]), 4
    found = []
    for i, j in pairs(a.shape[1]):
        y = a[:, j, order:]
        past = [a[:, which, order - lag : a.shape[-1] - lag] for which in (j, i) for lag in range(1, order + 1)]
        design = torch.stack([torch.ones_like(y), *past], -1)
        small, large = (_residual(y, design[..., :columns]) for columns in (1 + order, 1 + 2 * order))
        degrees = y.shape[-1] - 1 - 2 * order
        found.append(((small - large).clamp(min=1e-12) / order / (large / degrees).clamp(min=1e-12)).log())
    return torch.stack(found, 1)


def _residual(y: Float[Tensor, "S T"], design: Float[Tensor, "S T P"]) -> Float[Tensor, " S"]:
    gram = design.mT @ design + 1e-6 * torch.eye(design.shape[-1], dtype=y.dtype)
    fitted = design @ torch.linalg.solve(gram, design.mT @ y[..., None])
    return (y - fitted[..., 0]).square().sum(-1)


def _from_ahead(scenes: KnownScenes) -> Bool[Tensor, " E"]:
    return torch.tensor([i > j for i, j in pairs(scenes.state.shape[1])])


def with_threshold(score: Score) -> Callable[[Sequence[KnownScenes], Sequence[KnownScenes], int], Infer]:
    """Turn a score into a probability by logistic regression on the validation scenes, for pairs from ahead only."""

    def prepare(train: Sequence[KnownScenes], validation: Sequence[KnownScenes], seed: int) -> Infer:
        del train, seed
        x = torch.cat([score(known)[:, _from_ahead(known)].flatten() for known in validation])
        y = torch.cat([known.graph()[:, _from_ahead(known)].flatten() for known in validation]).double()
        weight = torch.where(y > 0, 0.5 / y.mean(), 0.5 / (1 - y.mean()))
        w = torch.zeros(2, dtype=torch.float64)
        centre, unit = x.mean(), x.std()
        design = torch.stack([(x - centre) / unit, torch.ones_like(x)], -1)
        for _ in range(25):  # Newton steps
            p = (design @ w).sigmoid()
            slope = design.mT @ (weight * (y - p)) - 1e-3 * w
            curvature = design.mT @ (design * (weight * p * (1 - p))[:, None]) + 1e-3 * torch.eye(2, dtype=w.dtype)
            w = w + torch.linalg.solve(curvature, slope)
        return lambda known: ((score(known) - centre) / unit * w[0] + w[1]).sigmoid() * _from_ahead(known)

    return prepare


def closed_form(train: Sequence[KnownScenes], validation: Sequence[KnownScenes], seed: int) -> Infer:
    """Weights of the explanations from the training scenes of all drivers together, without their relations."""
    del validation
    states = torch.cat([observed(known)[:150] for known in train])
    weights = explain(states[..., 0], states[..., 1], DT, LENGTH, seed=seed).weights()

    def infer(known: KnownScenes) -> Float[Tensor, "S E"]:
        seen = observed(known)
        return follow_probabilities(explain(seen[..., 0], seen[..., 1], DT, LENGTH, seed=seed).posterior(weights))

    return infer


def _model(model: RelationalModel) -> Infer:
    """P(follow) by an encoder, from the last states that it wants to see; a pair encoder sees all of them."""
    follow = model.config.vocabulary.index(EdgeType.FOLLOW)

    @torch.no_grad()
    def infer(known: KnownScenes) -> Answer:
        seen = observed(known).float()
        last = seen if isinstance(model.encoder, PairEncoder) else seen[:, :, -model.history_steps :]
        graph = model.infer(last)
        p = graph.probs[..., follow].double()
        return Answer(p, None if graph.unknown is None else graph.unknown.double()[:, None].expand_as(p))

    return infer


def _untrained(train: Sequence[KnownScenes], validation: Sequence[KnownScenes], seed: int) -> Infer:
    torch.manual_seed(seed)
    return _model(RelationalModel(checkpoint.load("us101_car_following").config).eval())


def _released(name: str) -> Row:
    return Row(f"released: {name}", "no labels; its own scenes", lambda *_: _model(checkpoint.load(name)))


def _with_prior(row: Row) -> Row:
    """The same row under the structured prior of `gri.bench.structure`."""
    given = row.given.replace(FLAT_PRIOR, STRUCTURED)
    return replace(row, name=f"{row.name} + prior", given=given, prepare=lambda *got: with_prior(row.prepare(*got)))


UNTRAINED = Row("untrained reward", f"nothing; {FLAT_PRIOR}", lambda *_: untrained_reward(structured=False))
GRI_REWARD = Row(
    "GRI, reward",
    f"no labels; {FLAT_PRIOR}; 600 scenes, 150 updates",
    lambda train, _, seed: fitted_reward(train, seed, structured=False),
    varies=True,
)
GRI_ENCODER = Row(
    "GRI, encoder",
    f"no labels; {FLAT_PRIOR}; 1,200 scenes, 150 + 500 updates",
    lambda train, _, seed: taught_encoder(train, seed),
    varies=True,
)
NRI = Row(
    "NRI",
    f"no labels; {FLAT_PRIOR}; 6,000 scenes, 400 updates",
    lambda train, _, seed: nri(train, seed),
    varies=True,
)
PER_STEP = Row(
    "NRI per step (as dNRI)",
    f"no labels; {FLAT_PRIOR}; 6,000 scenes, 600 updates",
    lambda train, _, seed: per_step(train, seed),
    varies=True,
)
PCMCI = Row(
    "PCMCI",
    "labels (threshold); senders ahead",
    lambda train, validation, seed: with_threshold(pcmci)(train, [known[:40] for known in validation], seed),
    needs="tigramite",
    most=60,
)
US101 = _released("us101_car_following")

ROWS: tuple[Row, ...] = (
    Row("nobody follows", "nothing", lambda *_: _nobody),
    Row("everybody follows the next", "nothing", lambda *_: _next_ahead),
    Row("prior alone", "nothing", lambda *_: _prior),
    Row("untrained encoder", "nothing", _untrained, varies=True),
    Row("lagged correlation", "labels (threshold)", with_threshold(lagged_correlation)),
    Row("Granger test", "labels (threshold)", with_threshold(granger)),
    Row(
        "geometry of the last frame",
        "labels",
        lambda train, _, seed: train_classifier(train, lambda state: state[:, :, WINDOW - 1 : WINDOW], seed, UPDATES),
        varies=True,
    ),
    PCMCI,
    NRI,
    _with_prior(NRI),
    PER_STEP,
    _with_prior(PER_STEP),
    UNTRAINED,
    replace(
        UNTRAINED,
        name="untrained reward + prior",
        given=f"nothing; {STRUCTURED}",
        prepare=lambda *_: untrained_reward(structured=True),
    ),
    GRI_REWARD,
    replace(_with_prior(GRI_REWARD), prepare=lambda train, _, seed: fitted_reward(train, seed, structured=True)),
    GRI_ENCODER,
    _with_prior(GRI_ENCODER),
    US101,
    _with_prior(US101),
    _released("ngsim_car_following"),
    _released("ngsim_relations"),
    Row("released: sumo_car_following", "labels (SUMO's)", _released("sumo_car_following").prepare),
    Row("closed form", "no labels; prior: one of those ahead, weights learned", closed_form, varies=True),
    Row(
        "labelled classifier (ceiling)",
        "labels",
        lambda train, _, seed: train_classifier(train, lambda state: state[:, :, :WINDOW], seed, UPDATES),
        varies=True,
    ),
)
