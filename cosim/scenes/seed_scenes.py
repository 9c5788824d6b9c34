"""The scenes of one seed: one simulation, one file."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from cosim.perturb.traffic_demand import perturbed_traffic
from cosim.scenes.candidates import Window, following_chains, merge_window, triples
from cosim.scenes.clips import Clip, cut_clip
from cosim.scenes.scene_filters import SceneFilter, Tally
from cosim.scenes.scene_rules import DT, TRIPLE_SHARES, Kind, Rules
from cosim.scenes.trajectory_buffer import BufferedStep, RoadSection, TrajectoryBuffer, VehicleNumbers
from cosim.spec.scenario import Scenario
from cosim.sumo import Sumo, sumo
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from gri.data.scene_file.schema import SceneBlock

SPLITS = ("train", "test", "validation", "train", "train", "train", "train", "test", "train", "train")
"""Split of seed k, counted from the first seed of a data set, modulo their number."""
CLIPS_AT_ONCE = 64  # that are filtered together, because array operations on few clips are slow


class SeedSpec(msgspec.Struct, frozen=True, kw_only=True):
    """One seed's share of a data set."""

    scenario: Scenario
    source: str
    split: str
    kinds: tuple[Kind, ...]
    count: int
    """Scenes of each kind, at most."""
    gold: bool
    rules: Rules


class SeedStatistics(msgspec.Struct, frozen=True, kw_only=True):
    """The scenes and labels of a seed in numbers, and its cost."""

    tallies: dict[Kind, dict[str, Any]]
    simulated: float
    """Simulated time after the warm-up [s]."""
    steps: int
    """Simulation steps after the warm-up."""
    warm_up_seconds: float
    """CPU time of the warm-up [s]."""
    seconds: float
    """CPU time after the warm-up [s], without that of copies of the process."""


def extract_scenes(spec: SeedSpec, net: Path, folder: Path, write: Callable[[SceneBlock], None]) -> SeedStatistics:
    """Simulate a seed and write its scenes with `write`; the same spec and versions give the same scenes.

    `net` is the net file; `folder` takes what SUMO reads and writes.
    """
    scenario, end = spec.scenario, spec.scenario.traffic.warm_up + spec.scenario.time_limit
    began = time.process_time()
    with undisturbed_traffic(scenario, net, folder, end) as world:
        for _ in range(scenario.steps(scenario.traffic.warm_up)):
            world.step()
        warm = time.process_time()
        extractor = SceneExtractor(world, spec)
        while not extractor.complete and (step := extractor.buffer.advance()).time < end:
            for block in extractor.process(step):
                write(block)
        for block in extractor.filter_clips():
            write(block)
        extractor.buffer.await_interventions()
        seconds = time.process_time() - warm
        simulated = extractor.buffer.count * DT
    tallies: dict[Kind, dict[str, Any]] = {
        kind: _tally_as_json(extractor.scene_filter.tallies[kind]) for kind in spec.kinds
    }
    return SeedStatistics(
        tallies=tallies,
        simulated=round(simulated, 3),
        steps=round(simulated / scenario.step),
        warm_up_seconds=round(warm - began, 3),
        seconds=round(seconds, 3),
    )


@contextmanager
def undisturbed_traffic(scenario: Scenario, net: Path, folder: Path, end: float) -> Iterator[Sumo]:
    """A simulation of the scenario's traffic without policies, with demand until `end` [s].

    `folder` takes what SUMO reads and writes. This imports no torch, so that copies of the process are cheap.
    """
    files = SumoFiles(net, folder / "routes.rou.xml", folder / "sumo.log")
    inputs = prepare_simulation(scenario, files, end - scenario.traffic.warm_up)
    inputs.write()
    with sumo(inputs.arguments, files.log) as world:
        yield world


class SceneExtractor:
    """Finds candidates (windows) during the simulation, cuts clips out of the buffer, and filters them in batches."""

    def __init__(self, world: Sumo, spec: SeedSpec) -> None:
        scenario, self.spec = spec.scenario, spec
        stride = round(DT / scenario.step)
        road = world.net.road(scenario.road.edges, scenario.road.origin)
        section = RoadSection(world.net, road, scenario.road.edges, scenario.road.length)
        self._numbers = VehicleNumbers([flow.name for flow in scenario.traffic.flows])
        length = spec.rules.longest + 1
        self.buffer = TrajectoryBuffer(
            world,
            section,
            self._numbers,
            length=length,
            dt=scenario.step,
            stride=stride,
            gold=spec.gold,
            models={of.name: of.car_following for of in perturbed_traffic(scenario).traffic.vehicles},
        )
        self.scene_filter = SceneFilter(spec.rules, section, scenario.step, stride, spec.count, spec.gold)
        self._rng = np.random.default_rng(scenario.seed)
        self._windows: list[Window] = []
        self._clips: list[Clip] = []

    @property
    def complete(self) -> bool:
        """Whether there are enough scenes of every kind."""
        return all(self.scene_filter.full(kind) for kind in self.spec.kinds)

    def process(self, step: BufferedStep) -> list[SceneBlock]:
        """Find and cut candidates at a new step; returns scenes once enough clips wait."""
        rules, kinds = self.spec.rules, [kind for kind in self.spec.kinds if not self.scene_filter.full(kind)]
        if "merge" in kinds:
            self._find_merges(step)
        if "car_following" in kinds and step.index and step.index % rules.following_steps == 0:
            self._find_chains(step)
        if "triple" in kinds and step.index and step.index % rules.triple_steps == 0:
            self._find_triples(step)
        before = len(self._clips)
        ending = [w for w in self._windows if w.begin + rules.steps(w.kind) == step.index]
        self._windows = [w for w in self._windows if w.begin + rules.steps(w.kind) > step.index]
        for window in ending:
            clip = cut_clip(window, self.buffer, rules.steps(window.kind))
            if clip is None:
                self._rejected(window.kind)["left the road section"] += 1
            else:
                self._clips.append(clip)
        return self.filter_clips() if len(self._clips) > before and self._enough_clips() else []

    def _enough_clips(self) -> bool:
        """Whether many clips wait, or enough to complete a kind."""
        waiting: Counter[Kind] = Counter(clip.kind for clip in self._clips)
        return sum(waiting.values()) >= CLIPS_AT_ONCE or any(
            count >= self.scene_filter.missing(kind) for kind, count in waiting.items()
        )

    def filter_clips(self) -> list[SceneBlock]:
        """The scenes among the clips that wait."""
        clips, self._clips, spec = self._clips, [], self.spec
        blocks = [
            self.scene_filter.scenes(
                kind,
                [clip for clip in clips if clip.kind == kind],
                spec.source,
                f"seed {spec.scenario.seed}",
                spec.split,
            )
            for kind in spec.kinds
        ]
        return [block for block in blocks if block is not None]

    def _rejected(self, kind: Kind) -> Counter[str]:
        return self.scene_filter.tallies[kind].rejected

    def _find_merges(self, step: BufferedStep) -> None:
        steps, counts = list(self.buffer.steps), self._rejected("merge")
        rules, seed = self.spec.rules, self.spec.scenario.seed
        found = (merge_window(change, steps, self._numbers, rules, counts, seed) for change in step.changes)
        self._windows += [window for window in found if window is not None]

    def _find_chains(self, step: BufferedStep) -> None:
        """Add up to `Rules.at_once` chains of the last T steps, drawn at random; no vehicle is in two of them."""
        rules, taken, found = self.spec.rules, set(), 0
        steps = list(self.buffer.steps)[-rules.following_steps - 1 :]
        counts, size = self._rejected("car_following"), self.spec.scenario.group.size
        chains = following_chains(steps, self.buffer.section.lanes, counts, size)
        for k in self._rng.permutation(len(chains)):
            chain = chains[k]
            if (
                found == rules.at_once
                or taken & set(chain)
                or self.scene_filter.vehicle_limit_reached("car_following", chain)
            ):
                continue
            found, taken = found + 1, taken | set(chain)
            self._windows.append(Window("car_following", chain, step.index - rules.following_steps))

    def _find_triples(self, step: BufferedStep) -> None:
        """Add up to `Rules.triples_at_once` triples of the last T steps, drawn at random in the wanted shares."""
        rules, taken = self.spec.rules, set()
        steps = list(self.buffer.steps)[-rules.triple_steps - 1 :]
        found = triples(steps, self.buffer.section, rules)
        names = list(found)
        shares = np.array([TRIPLE_SHARES[name] for name in names])
        for which in self._rng.choice(len(names), rules.triples_at_once, p=shares / shares.sum()).tolist():
            candidates = found[names[which]]
            for k in self._rng.permutation(len(candidates)):
                trio = candidates[k]
                if not taken & set(trio) and not self.scene_filter.vehicle_limit_reached("triple", trio):
                    taken |= set(trio)
                    self._windows.append(Window("triple", trio, step.index - rules.triple_steps))
                    break


def _tally_as_json(tally: Tally) -> dict[str, Any]:
    """A tally as built-in types, for JSON."""
    return {
        "scenes": tally.scenes,
        "rejected": dict(sorted(tally.rejected.items())),
        "unambiguous": tally.unambiguous,
        "rarest": dict(sorted(tally.rarest.items())),
        "graphs": dict(sorted(tally.graphs.items())),
        "step_labels": tally.step_labels.tolist(),
        "edges": tally.edges.tolist(),
        "rule_gold": tally.rule_gold.counts.tolist(),
        "hypothesis": tally.hypothesis.counts.tolist(),
    }
