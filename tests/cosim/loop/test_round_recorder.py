"""What a round's recorder says about vehicles that were not where they had been commanded to be."""

import numpy as np
from msgspec.structs import replace

from cosim.loop.observation import GroupObservation
from cosim.loop.round_recorder import Round, RoundRecorder
from cosim.loop.state_layouts import Pose
from cosim.spec.loading import load_scenario
from cosim.world.episode import COLUMNS, Event, EventKind
from cosim.world.groups import Group

GROUPS = Group(("a", "b", "c"), 0.0), Group(("d", "e", "f"), 0.0)
S, V = COLUMNS.index("s"), COLUMNS.index("v")


def recorder() -> RoundRecorder:
    rule = replace(load_scenario("us101_car_following").group, size=3)
    return RoundRecorder(Round(GROUPS, rule, (0, 1), 40, 0, 0.2), np.full((2, 3), 1.8))


def observed(time: float, s: np.ndarray, missing: tuple[int, int] | None = None) -> GroupObservation:
    state, valid = np.zeros((2, 3, len(COLUMNS))), np.ones((2, 3), bool)
    state[..., S], state[..., V] = s, 10.0
    if missing:
        valid[missing] = False
    return GroupObservation(time, state, valid, np.arange(6).reshape(2, 3))


def pose(s: np.ndarray) -> Pose:
    return Pose(s, 0 * s, 0 * s, 0 * s + 10.0, 0 * s)


def test_vehicles_at_their_places_give_no_event():
    found, s = recorder(), np.arange(6.0).reshape(2, 3)
    s_of_leaders = s + np.array([0.0, 0.0, 5.0])  # nobody commands them
    found.verify([observed(0.2, s_of_leaders + 9e-7)], [(pose(s), [0, 1])])
    assert found.events == [[], []]


def test_each_step_and_vehicle_that_was_elsewhere_or_gone_is_told_before_later_events():
    found, s = recorder(), np.arange(6.0).reshape(2, 3)
    found.add(1, Event(0.4, EventKind.HANDED_BACK, ("d", "e")))
    elsewhere = s + np.array([[0.0, 0.25, 0.0], [0.0, 0.0, 0.0]])
    trace = [observed(0.2, elsewhere), observed(0.4, s, missing=(1, 0)), observed(0.6, elsewhere, missing=(1, 0))]
    found.verify(trace, [(pose(s), [0, 1]), (pose(s), [0, 1]), (pose(s), [])])
    assert found.events[0] == [Event(0.2, EventKind.MISPLACED, ("b",), "by 0.25")]
    assert [(event.time, event.kind, event.vehicles) for event in found.events[1]] == [
        (0.4, EventKind.VANISHED, ("d",)),
        (0.4, EventKind.HANDED_BACK, ("d", "e")),
    ]
