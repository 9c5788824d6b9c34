"""Which clips become scenes, and what is written about them."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Int

from cosim.measures.label_agreement import Agreement, agreement
from cosim.measures.relation_labels import (
    FOLLOW,
    PairLabels,
    pair_labels,
    reactions_by_intervention,
    reactions_by_rule,
    reduce_labels,
)
from cosim.scenes.clips import Clip, decisions_known, driver_records_of, intervention_effects
from cosim.scenes.scene_rules import DT, KINDS, RAREST, TRIPLE_SHARES, Kind, Rarest, Rules, hypothesis
from cosim.scenes.scene_states import road_positions, scene_features
from cosim.scenes.trajectory_buffer import RoadSection
from gri.core.edges import LANE_CHANGING, pairs
from gri.data.scene_file.schema import SceneBlock, names_of

K = len(LANE_CHANGING)
NAMES = np.array([str(kind) for kind in LANE_CHANGING], object)
LANE_CHANGE = 1.0  # [m]; a larger step of the lateral position is a lane change


@dataclass
class Tally:
    """Counts for one kind of scene: what happened to its candidates, and the labels of its scenes."""

    scenes: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    """Candidates by the first rule that they violate."""
    unambiguous: int = 0
    """Scenes in which every pair is unambiguous."""
    rarest: Counter[str] = field(default_factory=Counter)
    """Scenes by their rarest edge."""
    graphs: Counter[str] = field(default_factory=Counter)
    """Triples by their graph, in the words of `TRIPLE_SHARES`."""
    step_labels: np.ndarray = field(default_factory=lambda: np.zeros(K, int))
    """[K] Labels of all pairs and steps by type."""
    edges: np.ndarray = field(default_factory=lambda: np.zeros(K, int))
    """[K] Edges of all scenes by type."""
    rule_gold: Agreement = field(default_factory=lambda: Agreement(np.zeros((K, K), int)))
    """Of rule labels with gold labels, over all steps of scenes that have gold labels."""
    hypothesis: Agreement = field(default_factory=lambda: Agreement(np.zeros((K, K), int)))
    """Of the geometric hypothesis with the edges."""


class SceneFilter:
    """Makes scenes of clips in the order in which they come, up to `count` scenes of each kind."""

    def __init__(self, rules: Rules, section: RoadSection, dt: float, stride: int, count: int, gold: bool) -> None:
        self._rules, self._section, self._count, self._gold = rules, section, count, gold
        self._dt, self._stride = dt, stride
        self._scenes_of: dict[Kind, Counter[int]] = {kind: Counter() for kind in KINDS}
        self.tallies: dict[Kind, Tally] = {kind: Tally() for kind in KINDS}

    def full(self, kind: Kind) -> bool:
        """Whether there are enough scenes of a kind."""
        return self.missing(kind) <= 0

    def missing(self, kind: Kind) -> int:
        """How many more scenes of a kind are needed."""
        return self._count - self.tallies[kind].scenes

    def vehicle_limit_reached(self, kind: Kind, vehicles: Sequence[int]) -> bool:
        """Whether one of the vehicles is already in `Rules.per_vehicle` scenes of a kind."""
        return any(self._scenes_of[kind][vehicle] >= self._rules.per_vehicle for vehicle in vehicles)

    def scenes(self, kind: Kind, clips: Sequence[Clip], source: str, recording: str, split: str) -> SceneBlock | None:
        """The scenes among clips of one kind; None if no clip passes."""
        if not clips:
            return None
        records = driver_records_of(clips, self._dt, self._stride)
        s, d = road_positions(clips, self._section)
        rule = pair_labels(reactions_by_rule(records), records.vehicle)
        labels = rule
        if self._gold:
            labels = pair_labels(reactions_by_intervention(records, *intervention_effects(clips)), records.vehicle)
        graph, clear = reduce_labels(labels, self._rules.reduction, round(self._rules.least_clear / DT))
        violated = violations(kind, self._rules, s, d, labels)
        if self._gold:
            violated.insert(0, ("a driver's last decision is unknown", ~decisions_known(clips)))
        chosen = self._select(kind, clips, violated, graph)
        if not len(chosen):
            return None
        labels, rule = (PairLabels(of.types[chosen], of.effect[chosen]) for of in (labels, rule))
        size = records.vehicle.shape[1]
        supposed = names_of(hypothesis(kind, size), size)
        self._count_labels(kind, labels, rule, graph[chosen], clear[chosen], supposed)
        speeds = np.stack([clips[k].speeds for k in chosen])
        return SceneBlock(
            kind=kind,
            source=np.full(len(chosen), source, object),
            recording=np.full(len(chosen), recording, object),
            split=np.full(len(chosen), split, object),
            start=np.array([clips[k].time for k in chosen]),
            vehicle=records.vehicle[chosen],
            features=scene_features(s[chosen], d[chosen], speeds, self._dt, self._rules.sideways),
            edges=NAMES[graph[chosen]],
            size={
                name: np.array([[getattr(driver, name) for driver in clips[k].drivers] for k in chosen])
                for name in ("length", "width")
            },
            step_edges=NAMES[labels.types],
            rule_edges=NAMES[rule.types],
            effect=labels.effect,
            hypothesis=np.broadcast_to(supposed, (len(chosen), len(supposed))),
            unambiguous=np.asarray(clear[chosen].all(1)),
            vehicle_type=np.array([[driver.kind for driver in clips[k].drivers] for k in chosen], object),
        )

    def _select(
        self,
        kind: Kind,
        clips: Sequence[Clip],
        violated: Sequence[tuple[str, Bool[np.ndarray, " S"]]],
        graph: np.ndarray,
    ) -> np.ndarray:
        """Indices of the clips that become scenes; the others are counted by the first rule that they violate."""
        tally, chosen = self.tallies[kind], []
        for k, clip in enumerate(clips):
            reason = next((name for name, clips_that_do in violated if clips_that_do[k]), "")
            present = NAMES[graph[k]]
            rarest: Rarest = next(name for name in RAREST if name in present)
            limit = self._rules.at_most.get(rarest, 1.0) * self._count
            if not reason and self.full(kind):
                return np.array(chosen, int)
            if not reason and self.vehicle_limit_reached(kind, clip.window.vehicles):
                reason = "a vehicle in enough scenes"
            if not reason and tally.rarest[rarest] >= limit:
                reason = f"enough scenes with {rarest}"
            name = following_in_words(graph[k]) if kind == "triple" else ""
            if not reason and name and tally.graphs[name] >= TRIPLE_SHARES.get(name, 0.0) * self._count:
                reason = f"enough triples where {name}"
            if reason:
                tally.rejected[reason] += 1
                continue
            chosen.append(k)
            tally.scenes += 1
            tally.rarest[rarest] += 1
            tally.graphs.update([name] if name else [])
            self._scenes_of[kind].update(clip.window.vehicles)
        return np.array(chosen, int)

    def _count_labels(
        self,
        kind: Kind,
        labels: PairLabels,
        rule: PairLabels,
        graph: np.ndarray,
        clear: np.ndarray,
        supposed: np.ndarray,
    ) -> None:
        tally = self.tallies[kind]
        tally.unambiguous += int(clear.all(1).sum())
        tally.step_labels = tally.step_labels + np.bincount(labels.types.ravel(), minlength=K)
        tally.edges = tally.edges + np.bincount(graph.ravel(), minlength=K)
        if self._gold:
            tally.rule_gold = tally.rule_gold + agreement(rule.types, labels.types, K)
        index = np.array([int(np.flatnonzero(name == NAMES)[0]) for name in supposed])
        tally.hypothesis = tally.hypothesis + agreement(np.broadcast_to(index, graph.shape), graph, K)


def following_in_words(graph: Int[np.ndarray, " E"]) -> str:
    """Who follows whom, e.g. "0 follows 1, 1 follows 2"; `graph` are indices into `LANE_CHANGING`."""
    found = sorted((j, i) for (i, j), kind in zip(pairs(3), graph.tolist(), strict=True) if kind == FOLLOW)
    return ", ".join(f"{j} follows {i}" for j, i in found) or "nobody follows"


def violations(
    kind: Kind, rules: Rules, s: np.ndarray, d: np.ndarray, labels: PairLabels
) -> list[tuple[str, Bool[np.ndarray, " S"]]]:
    """Each rule by name, with a flag per clip that is True if the clip violates it.

    `s` and `d` [S, N, M] are positions in the road frame [m] at the M = T + 1 steps of the clips.
    """
    s, changes_lane = s[..., :-1], np.abs(np.diff(d[..., :-1])) > LANE_CHANGE
    rear_to_front = [1, 0, 2] if kind == "merge" else list(range(s.shape[1]))
    headway = np.diff(s[:, rear_to_front], axis=1)
    seconds = (labels.types != 0).sum((1, 2)) * DT
    lane_keepers = changes_lane[:, 1:] if kind == "merge" else changes_lane
    found: list[tuple[str, Bool[np.ndarray, " S"]]] = [("a vehicle changes lanes", np.any(lane_keepers, (1, 2)))]
    if kind == "merge":
        crossing = changes_lane[:, 0].argmax(1) + 1
        at = np.stack([headway[..., 0], np.take_along_axis(headway, crossing[:, None, None], 2)[..., 0]], -1)
        found += [
            ("changes lanes more than once", changes_lane[:, 0].sum(1) != 1),
            ("in another order at the crossing", np.any(at[..., 1] <= 0, 1)),
            ("too far apart", np.any(np.abs(at) >= rules.spacing, (1, 2))),
        ]
    elif kind == "triple":
        least, most = rules.triple_spacing
        found += [
            ("too close or in another order", np.any(headway < least, (1, 2))),
            ("too far apart", np.any(headway >= most, (1, 2))),
        ]
    else:
        found.append(("too far apart", np.any((headway >= rules.spacing) | (headway <= 0), (1, 2))))
    if kind != "merge":
        found.append(("another relation than following", np.any(labels.types > FOLLOW, (1, 2))))
    found.append(("standing", np.ptp(s[:, 0], axis=1) < rules.travel))
    if kind != "triple":
        found.append(("too little interaction", seconds < rules.interaction - 1e-9))
    return found
