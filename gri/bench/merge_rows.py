"""The rows of the benchmark of merges. A row turns scenes into probabilities per step and one graph per scene."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri import checkpoint
from gri.bench.merge_classifier import K, frame_features, teach
from gri.bench.merge_encoder import per_step, teach_encoder
from gri.bench.merge_scenes import MergeScenes
from gri.core.edges import LANE_CHANGING
from gri.data.recorded import with_vehicle_length
from gri.inference.step_relations import released_merge_constants
from gri.networks.encoder import Encoder
from gri.relations.broken_merges import X, Y
from gri.relations.merge_explanations import ALL_TERMS, CONSTANTS, Terms
from gri.relations.merge_motion import NOMINAL_LENGTH, motion_of
from gri.relations.merge_posterior import learn_constants, relations, scene_graphs

LEARNING_UPDATES, LEARNING_SCENES = 60, 90
FEWEST = 3  # states that the posterior needs


@dataclass(frozen=True)
class Inferred:
    """What a row says about S scenes."""

    steps: Float[Tensor, "S T E K"]
    graph: Int[Tensor, "S E"]


Infer = Callable[[MergeScenes], Inferred]
Prepare = Callable[["Training", int], Infer]


@dataclass(frozen=True)
class Training:
    """What rows may learn from."""

    scenes: tuple[MergeScenes, ...]
    """Of each site."""
    constants: Callable[[int], dict[str, float]]
    """Seed → driver constants learned from the motion of the scenes."""


@dataclass(frozen=True)
class Row:
    """A way to infer relations of merges."""

    name: str
    given: str
    """"nothing", "no labels" or "labels"."""
    prepare: Prepare
    """(what it may learn from, seed) → how to infer."""
    varies: bool = False
    """Whether the seed changes the answer."""
    ablation: bool = False


def _constant(per_step: bool) -> Prepare:
    """The most frequent relation of each pair (in each step), over all training scenes."""

    def prepare(train: Training, seed: int) -> Infer:
        del seed
        steps, graph = (
            torch.cat([part.steps for part in train.scenes]),
            torch.cat([part.graph for part in train.scenes]),
        )
        most = steps.mode(0).values if per_step else steps.flatten(0, 1).mode(0).values.expand(steps.shape[1:])
        p = torch.nn.functional.one_hot(most, K).double()
        common = graph.mode(0).values
        return lambda scenes: Inferred(p.repeat(len(scenes), 1, 1, 1), common.repeat(len(scenes), 1))

    return prepare


def _taught(kernel: int) -> Prepare:
    def prepare(train: Training, seed: int) -> Infer:
        features = torch.cat([frame_features(part) for part in train.scenes])
        steps, graph = (
            torch.cat([part.steps for part in train.scenes]),
            torch.cat([part.graph for part in train.scenes]),
        )
        model = teach(features, steps, graph, kernel, seed)

        @torch.no_grad()
        def infer(scenes: MergeScenes) -> Inferred:
            per_step, per_scene = model(frame_features(scenes))
            return Inferred(per_step.double().softmax(-1), per_scene.argmax(-1))

        return infer

    return prepare


def starts(seed: int) -> dict[str, float]:
    """Where learning begins: for seed 0 the defaults, else every constant times or over two at random."""
    if not seed:
        return dict(CONSTANTS)
    generator = torch.Generator().manual_seed(seed)
    factors = 2.0 ** (2 * torch.randint(2, (len(CONSTANTS),), generator=generator).double() - 1)
    wrong = {name: value * float(f) for (name, value), f in zip(CONSTANTS.items(), factors, strict=True)}
    return wrong | {"persistence": 0.5 if factors[0] < 1 else 0.9}


def learned(train: Sequence[MergeScenes], seed: int) -> dict[str, float]:
    """Constants by maximum likelihood of the motion of all sites' training scenes; no label is looked at."""
    generator = torch.Generator().manual_seed(100 + seed)
    motions = []
    for part in train:
        rows = torch.randperm(len(part), generator=generator)[: LEARNING_SCENES // len(train)]
        motions.append(part[rows].motion())
    names = ("x", "v", "a", "lane", "length")
    motion = replace(motions[0], **{name: torch.cat([getattr(m, name) for m in motions]) for name in names})
    return learn_constants(motion, starts(seed), updates=LEARNING_UPDATES, batch=8, seed=seed)[0]


def _posterior(terms: Terms = ALL_TERMS, learn: bool = True) -> Prepare:
    def prepare(train: Training, seed: int) -> Infer:
        constants = train.constants(seed) if learn else CONSTANTS

        def infer(scenes: MergeScenes) -> Inferred:
            motion = scenes.motion()
            steps = relations(motion, constants, terms)
            return Inferred(steps, scene_graphs(steps, motion, constants))

        return infer

    return prepare


def _encoder(train: Training, seed: int) -> Infer:
    """An encoder with 5 s of history that is taught the posterior of the training scenes."""
    constants = train.constants(seed)
    target = torch.cat([relations(part.motion(), constants) for part in train.scenes])
    state = torch.cat([as_the_models_see(part) for part in train.scenes])
    encoder = teach_encoder(state, target, train.scenes[0].dt, seed)

    def infer(scenes: MergeScenes) -> Inferred:
        steps = per_step(encoder, as_the_models_see(scenes))
        return Inferred(steps, scene_graphs(steps, scenes.motion(), constants))

    return infer


def _released(name: str) -> Prepare:
    """One graph from the first states, as the model wants to see them, for all steps."""

    def prepare(train: Training, seed: int) -> Infer:
        del train, seed
        model = checkpoint.load(name)
        assert model.config.vocabulary == LANE_CHANGING, f"{name} has other relations"

        @torch.no_grad()
        def infer(scenes: MergeScenes) -> Inferred:
            seen = as_the_models_see(scenes)[:, :, : model.history_steps]
            p = model.infer(seen.float()).probs.double()
            return Inferred(p[:, None].expand(-1, scenes.steps.shape[1], -1, -1), p.argmax(-1))

        return infer

    return prepare


def _released_encoder(name: str) -> Prepare:
    """The relations of each step, as a released encoder infers them from up to 5 s before it."""

    def prepare(train: Training, seed: int) -> Infer:
        del train, seed
        model, constants = checkpoint.load(name), released_merge_constants()
        assert model.config.vocabulary == LANE_CHANGING, f"{name} has other relations"
        assert isinstance(model.encoder, Encoder)
        encoder = model.encoder

        def infer(scenes: MergeScenes) -> Inferred:
            seen = as_the_models_see(scenes)
            seen[..., X] -= seen[:, -1:, :1, X].clone()  # from the leader's first position, where float32 is finest
            steps = per_step(encoder, seen)
            return Inferred(steps, scene_graphs(steps, scenes.motion(), constants))

        return infer

    return prepare


def _online(train: Training, seed: int) -> Infer:
    """What the posterior says about each step when it has seen nothing later."""
    constants = train.constants(seed)

    def infer(scenes: MergeScenes) -> Inferred:
        steps = torch.stack([_last(scenes, constants, step) for step in range(scenes.state.shape[2])], 1)
        return Inferred(steps, scene_graphs(steps, scenes.motion(), constants))

    return infer


def _last(scenes: MergeScenes, constants: Mapping[str, float], step: int) -> Float[Tensor, "S E K"]:
    """The posterior of a step from the states up to it; in the first two steps, from the first three states."""
    seen = scenes.state[:, :, : max(step + 1, FEWEST)]
    motion = motion_of(seen, scenes.lane_width, scenes.dt, scenes.length, unfinished=True)
    return relations(motion, constants, unfinished=True)[:, min(step, seen.shape[2] - 1)]


def as_the_models_see(scenes: MergeScenes) -> Float[Tensor, "S 3 T D"]:
    """States as released models expect them: y from the leader's lane, every vehicle 5 m long, net gaps kept."""
    state = scenes.state.clone()
    state[..., Y] -= scenes.state[:, -1:, :, Y].mean(-1, keepdim=True)
    return with_vehicle_length(NOMINAL_LENGTH, state, scenes.length)


def _without(name: str, terms: Terms) -> Row:
    return Row(f"without {name}", "no labels", _posterior(terms), ablation=True)


POSTERIOR = "label-free posterior"
ROWS: tuple[Row, ...] = (
    Row("constant per pair", "labels", _constant(False)),
    Row("constant per pair and step", "labels", _constant(True)),
    Row("prior alone (geometry, no motion)", "nothing", _posterior(Terms(motion=False), learn=False)),
    Row("geometry of one frame", "labels", _taught(1), varies=True),
    Row("released: us101_merge", "no labels", _released("us101_merge")),
    Row("released: mixed_merge", "labels (SUMO's)", _released("mixed_merge")),
    Row(POSTERIOR, "no labels", _posterior(), varies=True),
    Row(f"{POSTERIOR}, online", "no labels", _online, varies=True),
    Row("encoder taught by the posterior, 5 s of history", "no labels", _encoder),
    Row("released: merge_relations", "no labels; merges of both sites", _released_encoder("merge_relations")),
    Row("labelled, whole scene (ceiling)", "labels", _taught(5), varies=True),
    _without("one-sided binding", Terms(one_sided=False)),
    _without("unknown headways and gaps", Terms(latent_driver=False)),
    _without("outsiders", Terms(outsider=False)),
    _without("keeping one's speed", Terms(keep=False)),
    _without("adapting to a target", Terms(adapt=False)),
    _without("yielding by holding", Terms(hold=False)),
    _without("yielding by braking on", Terms(steady=False)),
    _without("lack of room", Terms(room=False)),
    _without("derived cut-ins", Terms(derived_cut_in=False)),
    _without("the chain", Terms(stay=0.01)),
    Row("without learned constants", "nothing", _posterior(learn=False), ablation=True),
)
