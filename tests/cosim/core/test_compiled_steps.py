"""The compiled core drives as Python does: whole episodes are compared, bit for bit, on all shipped scenarios."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest
import torch
from msgspec.structs import replace

from cosim.core import build_core, core_status
from cosim.core.library import library
from cosim.core.round_core import RoundCore
from cosim.loop.driving import RoundStart, drive, start_round
from cosim.loop.intervention import NoIntervention
from cosim.loop.trunk import Trunk
from cosim.loop.vehicles_ahead import SpeedRecord, vehicles_ahead
from cosim.process.fork import fork
from cosim.runs.policy_loading import driver_of
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import RssFilter
from cosim.traffic.running_simulation import RunningSimulation, simulation
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from cosim.traffic.warm_up import warm_up as warmed_up
from cosim.world.episode import Episode
from cosim.world.snapshot import Snapshot
from gri.core.policy import IntelligentDriver
from gri.errors import InputError

CAR_FOLLOWING, MERGE = "us101_car_following", "us101_merge"


@pytest.fixture(scope="module", autouse=True)
def _built(tmp_path_factory):
    """A core of these tests' own: what people have built, or not, stays as it is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        try:
            build_core()
        except InputError as error:
            pytest.skip(f"no compiled core: {error}")
        yield
    core_status.cache_clear()
    library.cache_clear()


def differences(one: object, other: object, path: str = "") -> list[str]:
    """Where two results differ in a bit, by name."""
    if dataclasses.is_dataclass(one):
        names = [field.name for field in dataclasses.fields(one)]
        return [at for name in names for at in differences(getattr(one, name), getattr(other, name), f"{path}.{name}")]
    if isinstance(one, torch.Tensor):
        return differences(one.numpy(), other.numpy(), path)  # type: ignore[attr-defined]
    if isinstance(one, np.ndarray):
        assert isinstance(other, np.ndarray)
        same = one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
        return [] if same else [path]
    if isinstance(one, list | tuple):
        assert isinstance(other, list | tuple)
        if len(one) != len(other):
            return [path]
        pairs = enumerate(zip(one, other, strict=True))
        return [at for k, (a, b) in pairs for at in differences(a, b, f"{path}[{k}]")]
    return [] if one == other else [path]


class Driven(NamedTuple):
    """What comes of a round, how many steps compiled code made, and on how many of these it decided as well."""

    result: tuple[list[Episode], int, int]
    steps: int
    decisions: int

    @property
    def episodes(self) -> list[Episode]:
        return self.result[0]


def driven(running: RunningSimulation, start: RoundStart, core: str) -> Driven:
    """What comes of a round with one of the cores."""
    steps, decisions, advance = 0, 0, RoundCore.advance

    def counted(*arguments, **options):
        nonlocal steps, decisions
        made = advance(*arguments, **options)
        steps += len(made[2])
        decisions += max(len(made[2]) - options["decided"], 0) if options["driving"] else 0
        return made

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COSIM_CORE", core)
        patch.setattr(RoundCore, "advance", counted)
        core_status.cache_clear()
        library.cache_clear()
        episodes = drive(running.world, running.frame, start)
        return Driven((episodes, running.world.teleports, running.world.collision_steps), steps, decisions)


def left_to_sumo(running: RunningSimulation, history: Sequence[Snapshot], plan: NoIntervention) -> SpeedRecord:
    """The speeds ahead of a round that is left to SUMO, for which both cores see the same."""
    vehicles = vehicles_ahead(plan.round.groups, history[-1])

    def record(core: str) -> tuple[Driven, SpeedRecord]:
        speeds = SpeedRecord(vehicles)
        start = start_round(running.frame, history, dataclasses.replace(plan, recorded=speeds), None)
        return driven(running, start, core), speeds

    (by_python, speeds), (compiled, other) = (
        fork(lambda core=core: record(core)).result() for core in ("python", "compiled")
    )
    assert by_python.steps == 0 < compiled.steps == len(speeds.steps)
    assert differences(by_python.result, compiled.result) == []
    assert speeds == other
    return speeds


def compare(name: str, tmp_path, *, groups: int = 4, warm_up: float = 120.0, rounds: int = 1, repeat: bool = False,
            settings: Sequence[str] = (), **changes) -> list[Driven]:  # fmt: skip
    """Drive the same rounds with both cores; what the compiled one gave."""
    scenario = load_scenario(name, settings=settings)
    traffic = replace(scenario.traffic, warm_up=warm_up)
    scenario = replace(scenario, traffic=traffic, groups_at_once=groups, watch=6.0, time_limit=600.0)
    driver = driver_of(scenario)
    assert driver is not None
    driver = dataclasses.replace(driver, **changes)
    files = SumoFiles(find_net(scenario.net), tmp_path / "routes.rou.xml", tmp_path / "sumo.log")
    inputs = prepare_simulation(scenario, files, scenario.time_limit)
    inputs.write()
    found = []
    with simulation(inputs) as running:
        trunk = Trunk(running, inputs.scenario, warmed_up(running.world, inputs.scenario, lambda *_: None))
        while len(found) < rounds:
            history = trunk.observe_history()
            this_round = trunk.find_groups(history, limit=groups)
            if not this_round.groups:
                continue
            plan = NoIntervention(this_round)
            if repeat:
                plan = plan.repeating(left_to_sumo(running, history, plan), history[-1])
            start = start_round(running.frame, history, plan, driver)
            by_python, compiled = (
                fork(lambda core=core, start=start: driven(running, start, core)).result()
                for core in ("python", "compiled")
            )
            assert by_python.steps == 0
            assert differences(by_python.result, compiled.result) == []
            found.append(compiled)
    return found


@pytest.mark.parametrize("name", [CAR_FOLLOWING, MERGE, "i80_car_following", "i80_merge", "us101_lively", "i80_lively"])
@pytest.mark.slow
def test_every_scenario_is_driven_with_the_same_bits(name, tmp_path):
    for round_ in compare(name, tmp_path, rounds=2, repeat=True):
        assert round_.steps >= len(round_.episodes[0].time) - 26


def test_groups_are_driven_with_the_same_bits(tmp_path):
    (only,) = compare(CAR_FOLLOWING, tmp_path, repeat=True)
    assert len(only.episodes) > 1
    assert only.steps == len(only.episodes[0].time) - 25


@pytest.mark.slow
def test_merges_are_driven_with_the_same_bits(tmp_path):
    endings = [of.episodes[0].ending.value for of in compare(MERGE, tmp_path, groups=1, rounds=3)]
    assert "merged" in endings


@pytest.mark.parametrize(
    ("name", "rounds", "more", "roles"),
    [
        ("highway_merge", 2, ["seed=4", "group.max_gap=60"], {2}),
        # vehicle 1, which is driven, does not let vehicle 0 in, and loses its role
        (MERGE, 2, ["seed=3", "horizon=15", "graph={source: enforced, edges: {0->1: none, 1->0: none}}"], {1}),
        pytest.param("i80_lively", 2, ["seed=6", "horizon=20", "reinfer_s=2"], {2}, marks=pytest.mark.slow),
    ],
)
def test_groups_that_others_join_are_driven_with_the_same_bits(name, rounds, more, roles, tmp_path):
    settings = ["group.newcomers=join", "policy.sees=everybody", *more]
    found = compare(name, tmp_path, groups=2, warm_up=150.0, rounds=rounds, repeat=True, settings=settings)
    changes = [change for of in found for episode in of.episodes for change in episode.role_changes]
    assert {change.role for change in changes} == roles
    assert all(of.decisions > 5 for of in found), "the core decides, too, unless vehicles are handed back"
    for episode in [episode for of in found for episode in of.episodes]:
        around = episode.surroundings
        assert around is not None
        names = [around.ids[k] for k in around.vehicle]
        place = dict(zip(zip(around.time.round(3), names, strict=True), around.feature("s"), strict=True))
        for time, members, s, valid in zip(
            episode.time.round(3), episode.members, episode.feature("s"), episode.valid, strict=True
        ):
            for vehicle, at, there in zip(members, s, valid, strict=True):
                assert not there or place.get((time, vehicle), at) == at, "of whoever has the role, to the last instant"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        (MERGE, ["group.newcomers=join", "policy.sees=everybody"]),
        (MERGE, ["group.newcomers=end", "policy.sees=everybody"]),
        (MERGE, ["group.newcomers=join", "policy.sees=everybody", "step=0.1"]),
        ("i80_merge", ["group.newcomers=join", "policy.sees=everybody"]),
        (CAR_FOLLOWING, ["group.newcomers=end", "policy.sees=everybody"]),
        (CAR_FOLLOWING, ["group.newcomers=join", "policy={kind: idm}"]),
        (MERGE, ["group.newcomers=join", "policy.sees=everybody", "safety={kind: rss}"]),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_both_options_are_driven_with_the_same_bits(name, settings, tmp_path):
    for of in compare(name, tmp_path, groups=2, rounds=2, repeat=True, settings=settings):
        first = of.episodes[0]
        assert of.steps == np.count_nonzero(first.time > first.group.time + 1e-6)
        by_python = "idm" in settings[-1] or "rss" in settings[-1]
        assert (of.decisions == 0) == by_python


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"reinfer": 5},
        {"policy": IntelligentDriver(dt=0.2)},
        {"policy": IntelligentDriver(dt=0.2, sees_nearby=True)},
        {"safety": RssFilter()},
    ],
    ids=["inferred again", "idm", "idm that sees others", "safety filter"],
)
def test_what_python_decides_is_driven_with_the_same_bits(changes, tmp_path):
    (only,) = compare(CAR_FOLLOWING, tmp_path, **changes)
    assert only.steps == len(only.episodes[0].time) - 25


@pytest.mark.slow
def test_a_curved_road_is_left_to_python(tmp_path):
    (only,) = compare("curved_merge", tmp_path, groups=1)
    assert only.steps == 0
