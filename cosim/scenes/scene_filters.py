"""Which candidates become scenes, and what is written of them."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool

from cosim.measures.label_agreement import Agreement, agreement
from cosim.measures.relation_labels import (
    FOLLOW,
    DriverRecords,
    PairLabels,
    by_intervention,
    by_rule,
    pair_labels,
    reduced,
)
from cosim.scenes.clips import Clip, driver_records_of, tried
from cosim.scenes.rules import DT, HYPOTHESIS, RAREST, Kind, Rarest, Rules
from cosim.scenes.scene_states import features, places
from cosim.scenes.trajectory_buffer import RoadSection
from gri.core.edges import LANE_CHANGING
from gri.data.scene_file.schema import SceneBlock, names_of

K = len(LANE_CHANGING)
Broken = Bool[np.ndarray, " S"]
NAMES = np.array([str(kind) for kind in LANE_CHANGING], object)


@dataclass
class Tally:
    """What became of the candidates of a kind, and what the labels of the scenes say."""

    scenes: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    unambiguous: int = 0
    rarest: Counter[str] = field(default_factory=Counter)
    """Scenes by their rarest edge."""
    step_labels: np.ndarray = field(default_factory=lambda: np.zeros(K, int))
    edges: np.ndarray = field(default_factory=lambda: np.zeros(K, int))
    rule_gold: Agreement = field(default_factory=lambda: Agreement(np.zeros((K, K), int)))
    """Of the labels of all steps; counted in scenes with gold labels."""
    hypothesis: Agreement = field(default_factory=lambda: Agreement(np.zeros((K, K), int)))
    """Of the geometric hypothesis with the edges."""


class SceneFilter:
    """Takes clips of all kinds in the order they come, up to `count` scenes of each."""

    def __init__(self, rules: Rules, stretch: RoadSection, step: float, every: int, count: int, gold: bool) -> None:
        self._rules, self._stretch, self._count, self._gold = rules, stretch, count, gold
        self._step, self._every = step, every
        self._used: dict[Kind, Counter[int]] = {"car_following": Counter(), "merge": Counter()}
        self.tallies: dict[Kind, Tally] = {"car_following": Tally(), "merge": Tally()}

    def full(self, kind: Kind) -> bool:
        """Whether there are enough scenes of a kind."""
        return self.wanted(kind) <= 0

    def wanted(self, kind: Kind) -> int:
        """How many more scenes of a kind are wanted."""
        return self._count - self.tallies[kind].scenes

    def worn(self, kind: Kind, vehicles: Sequence[int]) -> bool:
        """Whether one of the vehicles is in enough scenes of a kind."""
        return any(self._used[kind][vehicle] >= self._rules.per_vehicle for vehicle in vehicles)

    def scenes(self, kind: Kind, clips: Sequence[Clip], source: str, recording: str, split: str) -> SceneBlock | None:
        """The scenes among clips of one kind; None where there are none."""
        if not clips:
            return None
        told = driver_records_of(clips, self._step, self._every)
        s, d = places(clips, self._stretch)
        rule = pair_labels(by_rule(told), told.vehicle)
        labels = pair_labels(by_intervention(told, *tried(clips)), told.vehicle) if self._gold else rule
        graph, clear = reduced(labels, self._rules.reduction, round(self._rules.least_clear / DT))
        kept = self._kept(kind, clips, self._broken(kind, told, s, d, labels), graph)
        if not len(kept):
            return None
        labels, rule = (PairLabels(of.types[kept], of.effect[kept]) for of in (labels, rule))
        self._note(kind, labels, rule, graph[kept], clear[kept])
        hypothesis = names_of(HYPOTHESIS[kind])
        return SceneBlock(
            kind=kind,
            source=np.full(len(kept), source, object),
            recording=np.full(len(kept), recording, object),
            split=np.full(len(kept), split, object),
            start=np.array([clips[k].time for k in kept]),
            vehicle=told.vehicle[kept],
            features=features(s[kept], d[kept], self._speeds(clips, kept), self._step, self._rules.sideways),
            edges=NAMES[graph[kept]],
            size={
                name: np.array([[getattr(c, name) for c in clips[k].characters] for k in kept])
                for name in ("length", "width")
            },
            step_edges=NAMES[labels.types],
            rule_edges=NAMES[rule.types],
            effect=labels.effect,
            hypothesis=np.broadcast_to(hypothesis, (len(kept), len(hypothesis))),
            unambiguous=np.asarray(clear[kept].all(1)),
            vehicle_type=np.array([[c.kind for c in clips[k].characters] for k in kept], object),
        )

    def _speeds(self, clips: Sequence[Clip], kept: np.ndarray) -> np.ndarray:
        return np.stack([clips[k].speeds for k in kept])

    def _broken(
        self, kind: Kind, told: DriverRecords, s: np.ndarray, d: np.ndarray, labels: PairLabels
    ) -> list[tuple[str, Broken]]:
        """The rules, each with [S] whether a clip breaks it."""
        rules = self._rules
        s, moves = s[..., :-1], np.abs(np.diff(d[..., :-1])) > 1.0
        order = [0, 1, 2] if kind == "car_following" else [1, 0, 2]
        headway = np.diff(s[:, order], axis=1)
        seconds = (labels.types != 0).sum((1, 2)) * DT
        keepers = moves[:, 1:] if kind == "merge" else moves
        broken: list[tuple[str, Broken]] = [("a vehicle changes lanes", np.any(keepers, (1, 2)))]
        if kind == "merge":
            crossing = moves[:, 0].argmax(1) + 1
            at = np.stack([headway[..., 0], np.take_along_axis(headway, crossing[:, None, None], 2)[..., 0]], -1)
            broken += [
                ("changes lanes more than once", moves[:, 0].sum(1) != 1),
                ("in another order at the crossing", np.any(at[..., 1] <= 0, 1)),
                ("too far apart", np.any(np.abs(at) >= rules.spacing, (1, 2))),
            ]
        else:
            broken += [
                ("too far apart", np.any((headway >= rules.spacing) | (headway <= 0), (1, 2))),
                ("another relation than following", np.any(labels.types > FOLLOW, (1, 2))),
            ]
        return [
            *broken,
            ("standing", np.ptp(s[:, 0], axis=1) < rules.travel),
            ("too little interaction", seconds < rules.interaction - 1e-9),
        ]

    def _kept(
        self, kind: Kind, clips: Sequence[Clip], broken: list[tuple[str, Broken]], graph: np.ndarray
    ) -> np.ndarray:
        tally, kept = self.tallies[kind], []
        for k, clip in enumerate(clips):
            reason = next((name for name, of in broken if of[k]), "")
            present = NAMES[graph[k]]
            rarest: Rarest = next(name for name in RAREST if name in present)
            limit = self._rules.at_most.get(rarest, 1.0) * self._count
            if not reason and self.full(kind):
                return np.array(kept, int)
            if not reason and self.worn(kind, clip.window.vehicles):
                reason = "a vehicle in enough scenes"
            if not reason and tally.rarest[rarest] >= limit:
                reason = f"enough scenes with {rarest}"
            if reason:
                tally.rejected[reason] += 1
                continue
            kept.append(k)
            tally.scenes += 1
            tally.rarest[rarest] += 1
            self._used[kind].update(clip.window.vehicles)
        return np.array(kept, int)

    def _note(self, kind: Kind, labels: PairLabels, rule: PairLabels, graph: np.ndarray, clear: np.ndarray) -> None:
        tally = self.tallies[kind]
        tally.unambiguous += int(clear.all(1).sum())
        tally.step_labels = tally.step_labels + np.bincount(labels.types.ravel(), minlength=K)
        tally.edges = tally.edges + np.bincount(graph.ravel(), minlength=K)
        if self._gold:
            tally.rule_gold = tally.rule_gold + agreement(rule.types, labels.types, K)
        index = np.array([int(np.flatnonzero(name == NAMES)[0]) for name in names_of(HYPOTHESIS[kind])])
        tally.hypothesis = tally.hypothesis + agreement(np.broadcast_to(index, graph.shape), graph, K)
