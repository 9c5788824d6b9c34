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
from cosim.scenes.candidates import Window, chains, merge_of
from cosim.scenes.clips import Clip, cut
from cosim.scenes.rules import DT, Kind, Rules
from cosim.scenes.scene_filters import SceneFilter, Tally
from cosim.scenes.trajectory_buffer import BufferedStep, Numbers, RoadSection, TrajectoryBuffer
from cosim.spec.scenario import Scenario
from cosim.sumo import Sumo, sumo
from cosim.traffic.route_file import arguments, route_file, sign_file
from gri.data.scene_file.schema import SceneBlock

SPLITS = ("train", "test", "validation", "train", "train", "train", "train", "test", "train", "train")
"""Of seed k, counted from the first one, modulo their number."""
BATCH = 64  # clips that are looked at together


class Spec(msgspec.Struct, frozen=True, kw_only=True):
    """One seed's share of a data set."""

    scenario: Scenario
    source: str
    split: str
    kinds: tuple[Kind, ...]
    count: int
    """Scenes of each kind, at most."""
    gold: bool
    rules: Rules


class Figures(msgspec.Struct, frozen=True, kw_only=True):
    """What a seed brought and what it cost."""

    tallies: dict[Kind, dict[str, Any]]
    simulated: float
    """[s] after the warm-up."""
    steps: int
    warm_up_seconds: float
    """CPU time."""
    seconds: float
    """CPU time after the warm-up, without that of copies of the process."""


def film(spec: Spec, net: Path, folder: Path, write: Callable[[SceneBlock], None]) -> Figures:
    """Simulate a seed and write its scenes; the same spec and versions give the same scenes."""
    scenario, end = spec.scenario, spec.scenario.traffic.warm_up + spec.scenario.time_limit
    began = time.process_time()
    with running(scenario, net, folder, end) as world:
        for _ in range(scenario.steps(scenario.traffic.warm_up)):
            world.step()
        warm = time.process_time()
        reel = SceneExtractor(world, spec)
        while not reel.done and (moment := reel.tape.advance()).time < end:
            for block in reel.next(moment):
                write(block)
        for block in reel.finished_scenes():
            write(block)
        reel.tape.settle()
        seconds = time.process_time() - warm
        simulated = reel.tape.count * DT
    tallies: dict[Kind, dict[str, Any]] = {kind: _plain(reel.sieve.tallies[kind]) for kind in spec.kinds}
    return Figures(
        tallies=tallies,
        simulated=round(simulated, 3),
        steps=round(simulated / scenario.step),
        warm_up_seconds=round(warm - began, 3),
        seconds=round(seconds, 3),
    )


@contextmanager
def running(scenario: Scenario, net: Path, folder: Path, end: float) -> Iterator[Sumo]:
    """The scenario's undisturbed traffic with demand until `end` [s]; the folder is for what SUMO reads and writes.

    Light: it brings no torch, so that copies of the process are cheap.
    """
    traffic = perturbed_traffic(scenario).traffic
    routes, signs, log = (folder / name for name in ("routes.rou.xml", "routes.signs.xml", "sumo.log"))
    routes.write_text(route_file(traffic, scenario.seed, end))
    signs.write_text(sign_file(traffic))
    with sumo(arguments(scenario, *map(str, (net, routes, signs, log))), log) as world:
        yield world


class SceneExtractor:
    """Finds windows as the tape goes on, cuts them when they are over, and develops clips in batches."""

    def __init__(self, world: Sumo, spec: Spec) -> None:
        scenario, self.spec = spec.scenario, spec
        self._every = round(DT / scenario.step)
        road = world.net.road(scenario.road.edges, scenario.road.origin)
        stretch = RoadSection(world.net, road, scenario.road.edges, scenario.road.length)
        self._numbers = Numbers([flow.name for flow in scenario.traffic.flows])
        length = spec.rules.longest + 1
        self.tape = TrajectoryBuffer(
            world, stretch, self._numbers, length=length, step=scenario.step, every=self._every, gold=spec.gold
        )
        self.sieve = SceneFilter(spec.rules, stretch, scenario.step, self._every, spec.count, spec.gold)
        self._rng = np.random.default_rng(scenario.seed)
        self._waiting: list[Window] = []
        self._clips: list[Clip] = []

    @property
    def done(self) -> bool:
        """Whether there are enough scenes of every kind."""
        return all(self.sieve.full(kind) for kind in self.spec.kinds)

    def next(self, moment: BufferedStep) -> list[SceneBlock]:
        """Look at a new moment; whatever scenes are ready by now."""
        rules, kinds = self.spec.rules, [kind for kind in self.spec.kinds if not self.sieve.full(kind)]
        if "merge" in kinds:
            self._merges(moment)
        if "car_following" in kinds and moment.index and moment.index % rules.following_steps == 0:
            self._chains(moment)
        before = len(self._clips)
        due = [w for w in self._waiting if w.begin + rules.steps(w.kind) == moment.index]
        self._waiting = [w for w in self._waiting if w.begin + rules.steps(w.kind) > moment.index]
        for window in due:
            clip = cut(window, self.tape, rules.steps(window.kind))
            if clip is None:
                self._counts(window.kind)["left the stretch"] += 1
            else:
                self._clips.append(clip)
        return self.finished_scenes() if len(self._clips) > before and self._ready() else []

    def _ready(self) -> bool:
        """Whether there are many clips, or enough to be done with a kind."""
        waiting: Counter[Kind] = Counter(clip.kind for clip in self._clips)
        return sum(waiting.values()) >= BATCH or any(
            count >= self.sieve.wanted(kind) for kind, count in waiting.items()
        )

    def finished_scenes(self) -> list[SceneBlock]:
        """The scenes among the clips that wait."""
        clips, self._clips, spec = self._clips, [], self.spec
        blocks = [
            self.sieve.scenes(
                kind,
                [clip for clip in clips if clip.kind == kind],
                spec.source,
                f"seed {spec.scenario.seed}",
                spec.split,
            )
            for kind in spec.kinds
        ]
        return [block for block in blocks if block is not None]

    def _counts(self, kind: Kind) -> Counter[str]:
        return self.sieve.tallies[kind].rejected

    def _merges(self, moment: BufferedStep) -> None:
        moments, counts = list(self.tape.moments), self._counts("merge")
        found = (merge_of(change, moments, self._numbers, self.spec.rules, counts) for change in moment.changes)
        self._waiting += [window for window in found if window is not None]

    def _chains(self, moment: BufferedStep) -> None:
        """A few of the rows of three that were there for the last T steps; no vehicle in two of them."""
        rules, taken, found = self.spec.rules, set(), 0
        moments = list(self.tape.moments)[-rules.following_steps - 1 :]
        rows = chains(moments, self.tape.stretch.lanes, self._counts("car_following"))
        for k in self._rng.permutation(len(rows)):
            trio = rows[k]
            if found == rules.at_once or taken & set(trio) or self.sieve.worn("car_following", trio):
                continue
            found, taken = found + 1, taken | set(trio)
            self._waiting.append(Window("car_following", trio, moment.index - rules.following_steps))


def _plain(tally: Tally) -> dict[str, Any]:
    """A tally as JSON has it."""
    return {
        "scenes": tally.scenes,
        "rejected": dict(sorted(tally.rejected.items())),
        "unambiguous": tally.unambiguous,
        "rarest": dict(sorted(tally.rarest.items())),
        "step_labels": tally.step_labels.tolist(),
        "edges": tally.edges.tolist(),
        "rule_gold": tally.rule_gold.counts.tolist(),
        "hypothesis": tally.hypothesis.counts.tolist(),
    }
