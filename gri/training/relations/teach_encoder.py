"""Teach a `PairEncoder` the posterior over graphs, by scenes drawn from what the edges mean.

The scenes come from `gri.relations.reaction_scenes`: drivers of unknown kind, some of whom react to another vehicle of
the scene. Cross-entropy with the drawn relations is least at the posterior p(graph | motion), with all latents of the
drivers integrated out. So the encoder is the posterior, up to the error of its networks. No relation of recorded
traffic, of SUMO or of the expert's scenes is used.

Scenes are broken on purpose, so that the encoder cannot recite where vehicles stand. *Strangers*: the vehicles from one
of them on are replaced by those of another scene of nearly the same mean speed, at the same first headway; relations
across the break end. *Hidden vehicles*: vehicles of the scene are left out; their followers have an unseen leader.
"""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.networks.pair_encoder import NEVER, PairEncoder
from gri.progress import Progress, no_progress
from gri.relations.reaction_scenes import UNSEEN, ReactionPrior, Reactions, draw_reactions, joined, log_uniform
from gri.training.optimisation import Descent
from gri.training.training_state import TrainingState, no_state


class TeachingSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Scenes and updates of the teaching."""

    prior: ReactionPrior = ReactionPrior()
    scenes: int = 100_000
    steps: int = 61
    """States of a drawn scene."""
    window: tuple[int, int] = (20, 61)
    """Fewest and most states of a history; each batch has windows of one random length."""
    vehicles: tuple[int, int] = (2, 4)
    """Fewest and most vehicles that are observed."""
    strangers: float = 0.25
    """Share of scenes with strangers."""
    measurement_noise: tuple[float, float] = (0.001, 0.2)
    """Standard deviation of noise on x [m] and v [m/s], log-uniform, in 0.3 of the scenes."""
    updates: int = 12_000
    policy_updates: int = 2500
    """Updates after these, in which roll-outs of the policy under random graphs are shown besides."""
    batch: int = 192
    rate: float = 3e-3
    policy_rate: float = 1e-3


def teach_encoder(
    encoder: PairEncoder,
    settings: TeachingSettings,
    seed: int,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> None:
    """Train the encoder in place.

    With `state`, the training goes on where that one was stopped; the scenes are drawn again, the same ones.
    """
    generator = torch.Generator().manual_seed(seed)
    pool = draw_pool(settings, encoder.dt, generator, progress)
    descent = Descent(encoder.parameters(), settings.rate, settings.updates, clip=1.0)
    for update in (state or no_state()).updates("relations", settings.updates, generator, descent):
        loss = explanation_loss(encoder, broken_batch(pool, settings, generator))
        descent.step(loss)
        progress("relations", update + 1, settings.updates, float(loss.detach()))


def teach_policys_reactions(
    encoder: PairEncoder,
    driven: Reactions,
    settings: TeachingSettings,
    seed: int,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> None:
    """Train the encoder further, in place, with roll-outs `driven` of the policy under drawn graphs besides.

    So it knows how the vehicles react that the model itself drives.
    """
    generator = torch.Generator().manual_seed(seed)
    pool = draw_pool(settings, encoder.dt, generator, progress)
    descent = Descent(encoder.parameters(), settings.policy_rate, settings.policy_updates, clip=1.0)
    total = settings.policy_updates
    for update in (state or no_state()).updates("policy's reactions", total, generator, descent):
        loss = explanation_loss(encoder, broken_batch(pool, settings, generator))
        rows = torch.randint(len(driven), (settings.batch,), generator=generator)
        loss = loss + explanation_loss(encoder, with_noise(driven[rows], settings, generator))
        descent.step(loss)
        progress("policy's reactions", update + 1, total, float(loss.detach()))


def draw_pool(
    settings: TeachingSettings, dt: float, generator: torch.Generator, progress: Progress = no_progress
) -> Reactions:
    """At least `settings.scenes` drawn scenes."""
    parts: list[Reactions] = []
    drawn = 0
    while drawn < settings.scenes:
        parts.append(draw_reactions(settings.prior, 4096, settings.steps, dt, generator))
        drawn += len(parts[-1])
        progress("scenes", min(drawn, settings.scenes), settings.scenes, 0.0)
    return joined(parts)


def explanation_loss(encoder: PairEncoder, scenes: Reactions, merge_nulls: bool = False) -> Float[Tensor, ""]:
    """Cross-entropy of the explanations of all vehicles that have one ahead.

    `merge_nulls`: the scenes do not say whether a vehicle without a leader keeps a speed of its own or has an unseen
    leader; count both as `UNSEEN`.
    """
    scores = encoder.scores(torch.stack([scenes.x, scenes.v], -1))
    if merge_nulls:
        nobody = scores[..., :2].logsumexp(-1, keepdim=True)
        scores = torch.cat([torch.full_like(nobody, NEVER), nobody, scores[..., 2:]], -1)
    target = torch.where(scenes.leader >= 0, scenes.leader + 2, (scenes.leader == UNSEEN).long())
    last = scenes.x[:, :, -1]
    judged = last < last.amax(1, keepdim=True)
    return nn.functional.cross_entropy(scores[judged], target[judged])


def broken_batch(pool: Reactions, settings: TeachingSettings, generator: torch.Generator) -> Reactions:
    """Random windows of random scenes, some of them broken on purpose, as they would be measured."""

    def between(span: tuple[int, int]) -> int:
        return int(torch.randint(span[0], span[1] + 1, (1,), generator=generator))

    steps = between(settings.window)
    first = between((0, pool.x.shape[-1] - steps))
    rows = torch.randint(len(pool), (settings.batch,), generator=generator)
    window = slice(first, first + steps)
    scenes = Reactions(pool.x[rows, :, window], pool.v[rows, :, window], pool.leader[rows])
    scenes = hide_vehicles(scenes, between(settings.vehicles), generator)
    return with_noise(with_strangers(scenes, settings.strangers, generator), settings, generator)


def with_noise(scenes: Reactions, settings: TeachingSettings, generator: torch.Generator) -> Reactions:
    """Positions and speeds as they would be measured."""
    one_each = (len(scenes), 1, 1)
    sd = log_uniform(settings.measurement_noise, one_each, generator)
    sd = sd * (torch.rand(one_each, generator=generator) < 0.3)
    noise = torch.randn((2, *scenes.x.shape), generator=generator)
    return Reactions(scenes.x + sd * noise[0], scenes.v + sd * noise[1], scenes.leader)


def hide_vehicles(scenes: Reactions, shown: int, generator: torch.Generator) -> Reactions:
    """Scenes with `shown` of their vehicles: mostly neighbours, sometimes any. Leaders that are hidden are unseen."""
    count, n, steps = scenes.x.shape
    first = torch.randint(0, n - shown + 1, (count, 1), generator=generator)
    neighbours = first + torch.arange(shown)
    some = torch.rand((count, n), generator=generator).argsort(1)[:, :shown].sort(1).values
    chosen = torch.where(torch.rand((count, 1), generator=generator) < 0.7, neighbours, some)
    place = torch.full((count, n), UNSEEN).scatter(1, chosen, torch.arange(shown).expand(count, shown))
    leader = scenes.leader.gather(1, chosen)
    leader = torch.where(leader >= 0, place.gather(1, leader.clamp(min=0)), leader)
    index = chosen[..., None].expand(-1, -1, steps)
    return Reactions(scenes.x.gather(1, index), scenes.v.gather(1, index), leader)


def with_strangers(scenes: Reactions, share: float, generator: torch.Generator) -> Reactions:
    """In a share of the scenes the vehicles from a random one on are those of a scene of nearly the same mean speed.

    They begin where the replaced vehicles began. Scenes in which vehicles would touch are left out.
    """
    x, v, leader = scenes.x, scenes.v, scenes.leader
    count, n, _ = x.shape
    order = v.mean((1, 2)).argsort()
    other = torch.empty_like(order)
    other[order] = order.roll(int(torch.randint(1, 4, (1,), generator=generator)))
    broken = torch.rand(count, generator=generator) < share
    place = torch.randint(1, n, (count, 1), generator=generator)
    replaced = broken[:, None] & (torch.arange(n) >= place)
    moved = x[other] - x[other][..., :1] + x[..., :1]
    # A relation survives if both of its vehicles come from the same scene.
    theirs = torch.where((leader[other] >= 0) & (leader[other] < place), UNSEEN, leader[other])
    ours = torch.where(broken[:, None] & (leader >= place), UNSEEN, leader)
    x = torch.where(replaced[..., None], moved, x)
    apart = (x[:, 1:] - x[:, :-1] > 5.2).all(-1).all(-1)
    mixed = Reactions(x, torch.where(replaced[..., None], v[other], v), torch.where(replaced, theirs, ours))
    return mixed[apart]
