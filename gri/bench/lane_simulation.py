"""Simulated merges, refused merges, lane changes that concern nobody, and lane keepers beside a gap.

Vehicle 0 begins in the right lane beside the gap between the lag vehicle 1 and the leader 2. Four things are drawn
independently of each other: starts, who reacts to whom, how each driver drives, and when things happen. What is left
of a dependence comes from scenes that are thrown away, because of a contact or because the gap never was large enough.

A driver obeys the lowest of two accelerations of its car-following model. One is towards what is ahead in its own lane:
a vehicle of the scene, one that is not in the scene, or nobody. The other is towards a vehicle of the next lane to
which it adapts: the merger to the leader, the lag vehicle to the merger it yields to, the merger to the lag vehicle it
waits for. For a vehicle of the next lane nobody brakes harder than a courtesy limit.

A relation holds at a step where it changes the acceleration by more than `EFFECT`, in comparison with the same driver
without it. In the lane it is "follow"; before the merger is in its target lane, reacting to the vehicle that comes in
is "yield". The merger cuts in where the lag vehicle brakes for it within `CUT_IN_WINDOW` after it came into the lane;
the label holds from the first lateral motion until `CUT_IN_HOLD` after the merger is in the lane.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gri.bench.car_following_scenes import (
    LENGTH,
    OWN,
    SUBSTEPS,
    UNSEEN,
    SceneFamily,
    log_uniform,
    uniform,
    unseen_leaders,
    wander,
)
from gri.bench.driver_models import FREE, DriverModel
from gri.bench.lane_scenes import CUT_IN, FOLLOW, LAG, LEADER, MERGER, NONE, YIELD, LaneScenes, close_gaps, joined
from gri.core.edges import pairs

KINDS = ("merge", "refused merge", "change without relation", "lane keeper")
VEHICLES = 3
EFFECT = 0.1  # [m/s²]; SUMO's labels by intervention use the same
CUT_IN_WINDOW, CUT_IN_HOLD = 2.0, 1.0  # [s], as in SUMO's labels
LONGEST_INTERRUPTION = 4  # steps for which a relation may be without effect and still holds
AFTERMATH = 20  # steps that are simulated beyond the scene, to know what a change at its end leads to
CONTACT_WIDTH = 2.0  # [m] between centres, below which vehicles abreast touch
MOST_SLOWER = 4.0  # [m/s] below a vehicle of the next lane to which a driver adapts at most
SLOW = 8.0  # [m/s], below which lateral motion takes longer
ALONG = SceneFamily("lanes", headway=(15.0, 90.0))


@dataclass(frozen=True)
class LaneFamily:
    """What scenes are drawn from. Pairs of numbers are uniform ranges; SI units."""

    name: str
    along: SceneFamily = ALONG
    """Speeds, first headway of 1 to 2 (log-uniform), delays and noise; its probabilities of reactions are not used."""
    lane_width: tuple[float, float] = (3.0, 4.0)
    place: tuple[float, float] = (0.1, 0.9)
    """Where 0 begins between 1 and 2."""
    merger_spread: float = 2.0
    """Standard deviation of the merger's first speed around the others' [m/s]."""
    change_at: tuple[float, float] = (2.0, 10.0)
    """When 0 wishes to change lanes [s]; it begins when the gap is large enough."""
    change_time: tuple[float, float] = (3.0, 7.0)
    """Duration of a lane change above `SLOW` [s]."""
    early: tuple[float, float] = (0.5, 4.0)
    """Time before the wish at which the others, or 0 itself, begin to react [s]."""
    courtesy: tuple[float, float] = (1.0, 2.5)
    """Hardest braking for a vehicle of the next lane [m/s²]."""
    follows_leader: float = 0.5
    """Probability that 1 follows 2 at first; else it follows a leader that is not in the scene, or nobody."""
    adapts: float = 0.6
    """Probability that a merger adapts to its leader before it changes lanes."""
    follows: float = 0.8
    """Probability that a merger follows the leader once it is in the lane."""
    reacts: float = 0.8
    """Probability that the lag vehicle reacts to a merger."""
    yields: float = 0.6
    """Probability that a lag vehicle that reacts does so before the merger is in its lane."""
    waits: float = 0.5
    """Probability that a refused merger waits for the lag vehicle; else the lag vehicle closes the gap."""
    follows_in: float = 0.6
    """Probability that a merger that waited changes lanes behind the lag vehicle."""
    closing: tuple[float, float] = (1.3, 2.2)
    """Factor by which a lag vehicle that closes the gap overrates it."""
    drift: tuple[float, float] = (0.0, 0.3)
    """Share of the lane width by which a refused merger drifts towards the gap and back."""
    wobble: float = 0.15
    """Amplitude of the motion within the lane [m], at wavelengths of 60 to 250 m."""


@dataclass(frozen=True)
class Intentions:
    """Who reacts to whom in S scenes, and when; the graph of a scene before anything has moved."""

    source: Int[Tensor, "S 3"]
    """What each vehicle follows in its own lane at first: a vehicle, `OWN` or `UNSEEN`."""
    changes: Bool[Tensor, " S"]
    waits: Bool[Tensor, " S"]
    """0 lets 1 pass; if it changes, then behind 1."""
    adapts: Bool[Tensor, " S"]
    follows: Bool[Tensor, " S"]
    """0 follows 2 once it is in the lane."""
    yields: Bool[Tensor, " S"]
    reacts: Bool[Tensor, " S"]
    """1 follows 0 once 0 is in the lane."""
    closes: Bool[Tensor, " S"]
    wish: Float[Tensor, " S"]
    """[s]"""
    merger_from: Float[Tensor, " S"]
    lag_from: Float[Tensor, " S"]


def draw_lane_scenes(family: LaneFamily, model: DriverModel, counts: Mapping[str, int], seed: int) -> LaneScenes:
    """Draw scenes without contact; the same seed gives the same scenes.

    `counts` says how many scenes of each of the `KINDS` there are to be.
    """
    generator = torch.Generator().manual_seed(seed)
    counts = {name: count for name, count in counts.items() if count}
    kept: dict[str, list[LaneScenes]] = {name: [] for name in counts}
    drawn, fit = Counter[str](), Counter[str]()
    while missing := {name: wanted - fit[name] for name, wanted in counts.items() if fit[name] < wanted}:
        batch = {name: max(3 * count, 32) for name, count in missing.items()}
        kind = torch.cat([torch.full((count,), KINDS.index(name)) for name, count in batch.items()])
        scenes, fine = _simulate(family, model, kind, generator)
        for name, count in batch.items():
            rows = ((kind == KINDS.index(name)) & fine).nonzero()[:, 0]
            kept[name].append(scenes[rows])
            drawn[name] += count
            fit[name] += len(rows)
    parts = []
    for name, wanted in counts.items():
        part = joined(kept[name])[torch.arange(wanted)]
        share = torch.full((wanted,), fit[name] / drawn[name], dtype=torch.float64)
        parts.append(replace(part, acceptance=share))
    return joined(parts)


def draw_intentions(family: LaneFamily, kind: Int[Tensor, " S"], generator: torch.Generator) -> Intentions:
    """Who reacts to whom in scenes of these kinds (indices into `KINDS`), and when."""
    count = len(kind)

    def chance(share: float) -> Bool[Tensor, " S"]:
        return torch.rand(count, generator=generator) < share

    merge, refused, change = (kind == index for index in range(3))
    source = torch.where(torch.rand((count, VEHICLES), generator=generator) < family.along.unseen, UNSEEN, OWN)
    waits = refused & chance(family.waits)
    closes = refused & ~waits
    source[:, 1] = torch.where(chance(family.follows_leader) | closes, 2, source[:, 1])
    reacts = merge & chance(family.reacts)
    wish = uniform((count,), family.change_at, generator)
    merger_from, lag_from = (wish - uniform((count,), family.early, generator) for _ in range(2))
    return Intentions(
        source=source,
        changes=(waits & chance(family.follows_in)) | merge | change,
        waits=waits,
        adapts=(merge | closes) & chance(family.adapts),
        follows=merge & chance(family.follows),
        yields=reacts & chance(family.yields),
        reacts=reacts,
        closes=closes,
        wish=wish,
        merger_from=merger_from,
        lag_from=lag_from,
    )


def _sources(
    meant: Intentions, time: float, in_lane: Bool[Tensor, " S"]
) -> tuple[Int[Tensor, "S 3"], Int[Tensor, "S 3"]]:
    """What each vehicle follows in its lane, and to which vehicle of the next lane it adapts (`OWN` if to none)."""
    ahead, beside = meant.source.clone(), torch.full_like(meant.source, OWN)
    ahead[:, 0] = torch.where(in_lane & meant.follows, 2, ahead[:, 0])
    ahead[:, 0] = torch.where(in_lane & meant.waits, 1, ahead[:, 0])
    ahead[:, 1] = torch.where(in_lane & meant.reacts, 0, ahead[:, 1])
    outside = ~in_lane & (time >= meant.merger_from)
    beside[:, 0] = torch.where(outside & meant.adapts, 2, beside[:, 0])
    beside[:, 0] = torch.where(outside & meant.waits, 1, beside[:, 0])
    beside[:, 1] = torch.where(~in_lane & (time >= meant.lag_from) & meant.yields, 0, beside[:, 1])
    return ahead, beside


def _gap_is_free(meant: Intentions, x: Float[Tensor, "S 3"], v: Float[Tensor, "S 3"]) -> Bool[Tensor, " S"]:
    """Whether 0 may begin to change lanes: net gaps of 2 m, and more at speed and where the one behind is faster."""

    def free(front: int, rear: int) -> Bool[Tensor, " S"]:
        gap = x[:, front] - x[:, rear] - LENGTH
        return gap > 2.0 + 0.2 * v[:, rear] + (v[:, rear] - v[:, front]).clamp(min=0)

    return torch.where(meant.waits, free(1, 0), free(2, 0) & free(0, 1))


def _simulate(
    family: LaneFamily, model: DriverModel, kind: Int[Tensor, " S"], generator: torch.Generator
) -> tuple[LaneScenes, Bool[Tensor, " S"]]:
    """One scene of each given kind, and which of them are fit for use."""
    along, n, count = family.along, VEHICLES, len(kind)
    dt, shape = along.dt / SUBSTEPS, (count, n)
    steps = (along.steps - 1 + AFTERMATH) * SUBSTEPS + 1
    # Starts, intentions and drivers are drawn independently of each other.
    headway = log_uniform((count,), along.headway, generator)
    place = uniform((count,), family.place, generator)
    x = torch.stack([place * headway, torch.zeros_like(headway), headway], 1)
    spread = torch.tensor([family.merger_spread, along.speed_spread, along.speed_spread], dtype=torch.float64)
    noise = torch.randn(shape, generator=generator, dtype=torch.float64)
    v = (uniform((count, 1), along.speed, generator) + spread * noise).clamp(min=0)
    meant = draw_intentions(family, kind, generator)
    drivers = model.draw(shape, generator)
    wished = (v + uniform(shape, along.wished_surplus, generator)).clamp(min=1.0)
    delay = (uniform(shape, along.delay, generator) / dt).round().long()
    courtesy = uniform(shape, family.courtesy, generator)
    closing = uniform((count,), family.closing, generator)
    wished_path = wished + wander(shape, steps, dt, 8.0, generator)
    see_gap = 1 + along.perception_noise * wander(shape, steps, dt, 2.0, generator)
    see_speed = 10 * along.perception_noise * wander(shape, steps, dt, 2.0, generator)
    act = along.action_noise * wander(shape, steps, dt, 1.0, generator)
    unseen_x, unseen_v = unseen_leaders(along, v, steps, dt, generator)
    unseen_x = unseen_x + x + log_uniform(shape, along.headway, generator)
    width = uniform((count,), family.lane_width, generator)
    duration = uniform((count,), family.change_time, generator)
    drift = uniform((count,), family.drift, generator) * (kind == 1)

    past_x, past_v = (torch.empty(steps, count, 2 * n, dtype=torch.float64) for _ in range(2))
    scenes, own = torch.arange(count)[:, None], torch.arange(n)
    progress, started = torch.zeros(count, dtype=torch.float64), torch.zeros(count, dtype=torch.bool)
    path: list[Tensor] = []
    lateral: list[Tensor] = []
    labels: list[Tensor] = []
    moves: list[Tensor] = []
    for k in range(steps):
        time = k * dt
        past_x[k], past_v[k] = torch.cat([x, unseen_x[k]], 1), torch.cat([v, unseen_v[k]], 1)
        in_lane = meant.changes & (progress > 0.5)
        seen = (k - delay).clamp(min=0)
        parameters = {**drivers, "v0": wished_path[k].clamp(min=1.0)}
        tight = torch.ones_like(v)
        tight[:, 1] = torch.where(meant.closes & (time >= meant.lag_from), closing, tight[:, 1])

        def towards(
            source: Int[Tensor, "S 3"],
            k: int = k,
            seen: Tensor = seen,
            v: Tensor = v,
            tight: Tensor = tight,
            parameters: Mapping[str, Tensor] = parameters,
        ) -> tuple[Tensor, Tensor]:
            """What each driver would do about a source, and the source's speed."""
            rows = torch.where(source >= 0, source, torch.where(source == UNSEEN, n + own, own))
            distance = past_x[seen, scenes, rows] - past_x[seen, scenes, own] - LENGTH
            gap = torch.where(source == OWN, FREE, distance * see_gap[k] * tight)
            speed = past_v[seen, scenes, rows] + see_speed[k]
            return model.acceleration(parameters, v, gap, speed).clamp(-8.0, 3.0), speed

        ahead, beside = _sources(meant, time, in_lane)
        alone, _ = towards(torch.full_like(ahead, OWN))
        in_own_lane, _ = towards(ahead)
        polite, other_speed = towards(beside)
        polite = torch.maximum(polite, -courtesy)
        polite = torch.where(v < other_speed - MOST_SLOWER, polite.clamp(min=0), polite)
        polite = torch.where(beside == OWN, torch.inf, polite)
        without_merger, _ = towards(meant.source)
        wanted = torch.minimum(in_own_lane, polite)

        yielding = in_own_lane - wanted > EFFECT
        following = ~yielding & ((in_own_lane - alone).abs() > EFFECT)
        labels.append(_labels(ahead, beside, following, yielding))
        brakes = without_merger[:, 1] - wanted[:, 1] > EFFECT
        started = started | (meant.changes & (time >= meant.wish) & _gap_is_free(meant, x, v))
        drifts = (drift > 0) & (time >= meant.wish) & ~meant.changes
        moves.append(torch.stack([started, in_lane, brakes & meant.reacts], 1))
        path.append(torch.stack([x, v], -1))
        lateral.append(_offset(progress, meant.changes, width, drift))

        progress = progress + torch.where(started | drifts, dt / duration * (v[:, 0] / SLOW).clamp(max=1.0), 0.0)
        progress = progress.clamp(max=1.0)
        faster = (v + (wanted + act[k]).clamp(-8.0, 3.0) * dt).clamp(min=0)
        x, v = x + (v + faster) / 2 * dt, faster

    frames = torch.stack(path[::SUBSTEPS], 2)  # Shape: (S, N, T + aftermath, 2)
    y = _wobble(family, frames[..., 0], generator)
    y[:, 0] += torch.stack(lateral[::SUBSTEPS], 1)
    state = _with_heading(frames, y)[:, :, : along.steps]
    changed = torch.stack(moves, 1)
    relations = _per_step(torch.stack(labels, 1), along.steps)
    relations = _add_cut_ins(relations, changed, dt)
    fine = _is_free_of_contact(state) & (changed[:, (along.steps - 1) * SUBSTEPS - 1, 0] | ~meant.changes)
    lengths = torch.full(shape, LENGTH, dtype=torch.float64)
    names, unknown = tuple(KINDS[index] for index in kind.tolist()), torch.full((count,), torch.nan)
    return LaneScenes(state, width, lengths, relations, names, (MERGER, LAG, LEADER), unknown, along.dt), fine


def _labels(
    ahead: Int[Tensor, "S 3"],
    beside: Int[Tensor, "S 3"],
    following: Bool[Tensor, "S 3"],
    adapting: Bool[Tensor, "S 3"],
) -> Int[Tensor, "S 6"]:
    """Types of all ordered pairs at one substep, without cut-ins. Adapting to the leader of the target lane is follow;
    adapting to somebody behind the gap, or to the merger, is yield."""
    found = []
    for i, j in pairs(VEHICLES):
        kind = torch.where(following[:, j] & (ahead[:, j] == i), FOLLOW, NONE)
        found.append(torch.where(adapting[:, j] & (beside[:, j] == i), FOLLOW if i == 2 else YIELD, kind))
    return torch.stack(found, 1)


def _per_step(labels: Int[Tensor, "S K 6"], steps: int) -> Int[Tensor, "S T 6"]:
    """Labels of the steps of a scene from those of its substeps; short interruptions are filled."""
    parts = [labels[:, start : start + (steps - 1) * SUBSTEPS + 1 : SUBSTEPS] for start in range(SUBSTEPS)]
    return close_gaps(torch.stack(parts).amax(0), LONGEST_INTERRUPTION)


def _add_cut_ins(relations: Int[Tensor, "S T 6"], moves: Bool[Tensor, "S K 3"], dt: float) -> Int[Tensor, "S T 6"]:
    """Cut-ins of 0 ahead of 1, where 1 brakes for 0 within `CUT_IN_WINDOW` after 0 came into the lane."""
    started, in_lane, brakes = moves.unbind(-1)
    since = in_lane.cumsum(1)  # substeps in the lane
    braked = (brakes & in_lane & (since <= round(CUT_IN_WINDOW / dt))).any(1)
    holds = started & (since <= round(CUT_IN_HOLD / dt)) & braked[:, None]
    edge = pairs(VEHICLES).index((1, 0))
    found = relations.clone()
    steps = relations.shape[1]
    holds = holds[:, ::SUBSTEPS][:, :steps]
    found[..., edge] = torch.where(holds, CUT_IN, found[..., edge])
    return found


def _offset(
    progress: Float[Tensor, " S"], changes: Bool[Tensor, " S"], width: Float[Tensor, " S"], drift: Float[Tensor, " S"]
) -> Float[Tensor, " S"]:
    """y of vehicle 0 [m]: a lane change of least jerk, or a drift towards the gap and back."""
    smooth = progress**3 * (10 - 15 * progress + 6 * progress**2)
    return -width + width * torch.where(changes, smooth, drift * torch.sin(torch.pi * smooth) ** 2)


def _wobble(family: LaneFamily, x: Float[Tensor, "S N T"], generator: torch.Generator) -> Float[Tensor, "S N T"]:
    """Motion within the lane: an offset and two waves along the road, so that standing vehicles do not move."""
    shape = tuple(x.shape[:2])
    y = family.wobble * torch.randn(shape, generator=generator, dtype=torch.float64)[..., None].expand_as(x).clone()
    for _ in range(2):
        length, phase = (uniform(shape, bounds, generator) for bounds in ((60.0, 250.0), (0.0, 6.2832)))
        amplitude = family.wobble * torch.rand(shape, generator=generator, dtype=torch.float64)
        y += amplitude[..., None] * torch.sin(6.2832 * x / length[..., None] + phase[..., None])
    return y


def _with_heading(frames: Float[Tensor, "S N T 2"], y: Float[Tensor, "S N T"]) -> Float[Tensor, "S N T 4"]:
    """States with the heading along the path; where a vehicle stands it keeps none."""
    x, v = frames.unbind(-1)
    dx, dy = x[..., 1:] - x[..., :-1], y[..., 1:] - y[..., :-1]
    heading = torch.where(dx > 0.05, torch.atan2(dy, dx.clamp(min=0.05)), 0.0)
    return torch.stack([x, y, v, torch.cat([heading, heading[..., -1:]], -1)], -1)


def _is_free_of_contact(state: Float[Tensor, "S N T 4"]) -> Bool[Tensor, " S"]:
    """Whether no two vehicles that are abreast of each other come nearer than 0.3 m."""
    touching = torch.zeros(len(state), dtype=torch.bool)
    for i, j in pairs(state.shape[1]):
        along, across = ((state[:, i, :, d] - state[:, j, :, d]).abs() for d in (0, 1))
        touching |= ((along < LENGTH + 0.3) & (across < CONTACT_WIDTH)).any(-1)
    order_kept = (state[:, 2, :, 0] > state[:, 1, :, 0]).all(-1)  # 1 never passes through 2
    return ~touching & order_kept
