"""Groups that others join: who has which role, and whole drives in which somebody comes between."""

from dataclasses import dataclass, field

import msgspec
import numpy as np
import pytest
import torch

from cosim.loop.driving import Driver
from cosim.loop.membership import FAR, Membership
from cosim.loop.round_recorder import Round
from cosim.runs.run_tables import groups_table, steps_table
from cosim.spec.perturbations import KINDS
from cosim.spec.scenario import CarFollowing, Merge
from cosim.world.episode import Ending, EventKind, RoleChange
from cosim.world.groups import Group, MergeLanes, expected_graph
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import COLUMNS, LaneStrip, Snapshot
from gri.core.graph import YIELDING, EdgeType, InteractionGraph
from gri.core.policy import IntelligentDriver, PolicyState
from gri.core.trajectory import Trajectory

LANES = MergeLanes(LaneStrip("weave_0", 100.0, 300.0, -8.0, 4.0), LaneStrip("weave_1", 100.0, 300.0, -4.2, 3.6))
SOURCE, TARGET = -8.0, -4.2
ROAD = RoadFrame(np.array([[0.0, 0.0], [1000.0, 0.0]]))


def snapshot(time: float = 0.2, **vehicles: tuple[float, float]) -> Snapshot:
    """Vehicles by name at (s, d), 5 m long."""
    n = len(vehicles)
    s, d = np.array([*vehicles.values()], dtype=float).reshape(-1, 2).T
    return Snapshot(
        time=time,
        ids=tuple(vehicles),
        xy=np.zeros((n, 2)),
        heading=np.zeros(n),
        v=np.full(n, 10.0),
        a=np.zeros(n),
        s=s,
        d=d,
        length=np.full(n, 5.0),
        width=np.full(n, 1.8),
        lane=("weave_1",) * n,
    )


def members(rule=None, ids=("own", "lag", "leader"), driven=(0, 1)) -> Membership:
    rule = rule or Merge(lane="weave_0", zone=(100, 200), newcomers="join")
    lanes = LANES if isinstance(rule, Merge) else None
    return Membership(Round((Group(ids, 0.0),), rule, driven, 10, 0, 0.2, lanes=lanes))


OWN, LAG, LEADER = {"own": (200, SOURCE)}, {"lag": (190, TARGET)}, {"leader": (220, TARGET)}


@pytest.mark.parametrize(
    ("lag", "leader", "vehicles"),
    [
        ("lag", "leader", OWN | LAG | LEADER | {"other": (230, TARGET)}),  # beyond the leader
        ("lag", "leader", OWN | LAG | LEADER | {"other": (210, TARGET + 3.6)}),  # in the next lane
        ("lag", "other", OWN | LAG | LEADER | {"other": (210, TARGET)}),  # between, ahead of the merging vehicle
        ("other", "leader", OWN | LAG | LEADER | {"other": (198, TARGET)}),  # between, behind its front
        ("lag", "other", OWN | LAG | {"leader": (220, TARGET + 3.6), "other": (250, TARGET)}),  # the leader left
        ("lag", "", OWN | LAG),  # the leader is gone, and nobody else is ahead
        ("other", "leader", OWN | LEADER | {"other": (150, TARGET)}),
        ("lag", "leader", {"own": (222, SOURCE)} | LAG | LEADER),  # abreast of the leader, a little ahead
        ("leader", "", {"own": (225.5, SOURCE)} | LAG | LEADER),  # has passed it
        ("other", "lag", {"own": (200, SOURCE), "lag": (205.5, TARGET), "other": (180, TARGET)} | LEADER),  # was passed
        ("lag", "leader", {"own": (200, SOURCE), "lag": (204, TARGET), "other": (180, TARGET)} | LEADER),  # not wholly
    ],
)
def test_who_is_next_to_a_merging_vehicle(lag, leader, vehicles):
    found = members()
    changed = found.update(snapshot(**vehicles), [0])
    assert found.ids == [["own", lag, leader]]
    expected = [role for role, vehicle in enumerate(("own", "lag", "leader")) if vehicle != found.ids[0][role]]
    assert changed == ({0: expected} if expected else {})
    assert found.changes == [[RoleChange(0.2, role, found.ids[0][role]) for role in expected]]


def test_a_driven_vehicle_that_loses_its_role_is_not_driven_again():
    found = members()
    found.update(snapshot(0.2, **OWN, **LAG, **LEADER, other=(198, TARGET)), [0])
    assert found.driven.tolist() == [[True, False, False]]
    assert (found.driven_until(0, 0), found.driven_until(0, 1)) == (np.inf, 0.2)
    found.update(snapshot(0.4, **OWN, **LAG, **LEADER, other=(198, TARGET + 3.6)), [0])
    assert found.ids == [["own", "lag", "leader"]]  # it has its role again, and SUMO drives it
    assert found.driven.tolist() == [[True, False, False]]
    assert found.driven_until(0, 1) == 0.2


def test_a_group_that_has_ended_keeps_its_members():
    found = members()
    assert found.update(snapshot(**OWN, **LAG, **LEADER, other=(210, TARGET)), []) == {}
    assert found.ids == [["own", "lag", "leader"]]


@pytest.mark.parametrize(
    ("expected", "vehicles"),
    [
        ("abc", {"a": (0, 0), "b": (10, 0), "c": (20, 0), "x": (30, 0)}),
        ("axb", {"a": (0, 0), "b": (10, 0), "c": (20, 0), "x": (5, 0)}),
        ("abx", {"a": (0, 0), "b": (10, 0), "c": (20, 0), "x": (15, 0)}),
        ("abx", {"a": (0, 0), "b": (10, 0), "c": (20, 3.6), "x": (30, 0)}),
        ("acx", {"a": (0, 0), "b": (10, 3.6), "c": (20, 0), "x": (30, 0)}),
        ("ab", {"a": (0, 0), "b": (10, 0)}),
    ],
)
def test_who_follows_whom_in_a_lane(expected, vehicles):
    found = members(CarFollowing(newcomers="join"), tuple("abc"))
    found.update(snapshot(**vehicles), [0])
    assert found.ids == [[*expected, *[""] * (3 - len(expected))]]
    assert found.driven[0].tolist() == [True, expected[1] == "b", False]


def test_nobody_is_seen_far_away_and_as_fast():
    found = members()
    now = snapshot(own=(200, SOURCE))
    found.update(now, [0])
    observation = found.observe(now)
    assert observation.valid.tolist() == [[True, False, False]]
    shown = found.shown(observation, ROAD)
    s, d, v = (shown.state[0, :, COLUMNS.index(name)].tolist() for name in ("s", "d", "v"))
    assert (s, d, v) == ([200, 200 - FAR, 200 + FAR], [SOURCE, TARGET, TARGET], [10, 10, 10])
    assert not observation.state[0, 1:].any(), "what is recorded does not change"


@dataclass(frozen=True)
class Relating(IntelligentDriver):
    """Infers that nobody reacts to anybody, drives as IDM all the same, and remembers the graphs it was given."""

    graphs: list[InteractionGraph] = field(default_factory=list)

    def begin(self, history: Trajectory) -> PolicyState:
        graph = InteractionGraph.of_edges({}, YIELDING, history.state.shape[1], len(history.state))
        return PolicyState(graph, history.state.new_zeros(*history.state.shape[:2], 0))

    def act(self, memory: PolicyState, state: torch.Tensor):
        self.graphs.append(memory.graph)
        return super().act(memory, state)[0], memory


@pytest.fixture
def cut_in(short_scenario):
    """A neighbour that is made to cut in behind the leader."""
    spec = KINDS["neighbour_cut_in"](intensity=2.0)
    return msgspec.structs.replace(
        short_scenario, perturbations=(spec,), horizon=6.0, watch=2.0, episodes=3, groups_at_once=2
    )


def joining(scenario):
    return msgspec.structs.replace(scenario, group=msgspec.structs.replace(scenario.group, newcomers="join"))


def test_a_vehicle_that_cuts_in_joins_and_the_drive_goes_on(cut_in, simulate):
    policy = Relating(cut_in.step)
    outcome = simulate(joining(cut_in), policy)
    joined = [episode for episode in outcome.episodes if episode.role_changes]
    assert joined, "no neighbour cut in"
    for episode in joined:
        assert episode.ending in {Ending.HORIZON, Ending.CONTACT}
        first = episode.role_changes[0]
        assert first.role == 2
        assert first.vehicle not in episode.group.ids
        assert not {EventKind.MISPLACED, EventKind.VANISHED} & {event.kind for event in episode.events}
        assert (first.vehicle,) in {event.vehicles for event in episode.events if event.kind is EventKind.JOINED}
        assert episode.driven[episode.during_drive][1:, :2].all()  # both stay driven
        assert not episode.driven[:, 2].any()
    episode = joined[0]
    first = episode.role_changes[0]
    steps = steps_table([episode])
    leader = steps[steps["role"] == 2].set_index("time")["vehicle"]
    later = leader.index >= first.time - 1e-6
    assert set(leader[~later]) == {episode.group.leader}
    assert leader[later].iloc[0] == first.vehicle
    gap = steps[(steps["role"] == 1)].set_index("time")["gap"]
    assert gap[~later].notna().all()
    assert gap[later].isna().all()  # sizes in the table are those of the take-over
    assert groups_table([episode], expected_graph(cut_in.group))["joined"].tolist() == [
        len({change.time for change in episode.role_changes})
    ]


def test_whoever_joins_is_related_as_its_role_is(cut_in, simulate):
    """The policy believes in no relation; a newcomer it follows until both were together for a whole history."""
    scenario = joining(msgspec.structs.replace(cut_in, episodes=1, groups_at_once=1))
    policy = Relating(scenario.step)
    (episode,) = simulate(scenario, policy, forking=False).episodes
    if not episode.role_changes:
        pytest.skip("nobody cut in")
    assert episode.graph is not None
    graphs = [episode.graph[k : k + 1].edges() for k in range(len(episode.graph))]
    assert graphs[0] == {}
    at = int(np.searchsorted(episode.graph_time, episode.role_changes[0].time - 1e-6))
    assert graphs[at] == {(2, 1): (EdgeType.FOLLOW, pytest.approx(1.0))}


def test_without_a_newcomer_nothing_is_different(short_scenario, simulate):
    scenario = msgspec.structs.replace(short_scenario, episodes=3, horizon=2.0, watch=0.0)
    plain = simulate(scenario, Driver("idm", IntelligentDriver(scenario.step)))
    joined = simulate(joining(scenario), Driver("idm", IntelligentDriver(scenario.step)))
    kept = [k for k, episode in enumerate(plain.episodes) if episode.ending is Ending.HORIZON]
    assert kept
    for k in kept:
        assert not joined.episodes[k].role_changes
        np.testing.assert_array_equal(plain.episodes[k].state, joined.episodes[k].state)
