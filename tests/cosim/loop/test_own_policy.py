"""A policy that fails costs its own groups, and only these; the reason is recorded with its time."""

import os
import time
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
import pytest
import torch

from cosim.loop.driving import Driver
from cosim.loop.own_policy import OwnPolicy, PolicyFailure
from cosim.process.fork import CAN_FORK
from cosim.world.episode import Ending, EventKind
from gri.core.graph import FOLLOWING, InteractionGraph
from gri.core.policy import ConstantVelocity, PolicyState
from gri.core.trajectory import Trajectory

FAILS_AT = 6  # decisions


@dataclass(frozen=True)
class Bad(ConstantVelocity):
    """Constant velocity, until something goes wrong in the sixth decision."""

    wrong: Any = None  # function of (action, policy state)
    in_begin: bool = False
    decisions: list[int] = field(default_factory=list)

    def begin(self, history):
        self.decisions.clear()
        state = ConstantVelocity(self.dt).begin(history)
        return self.wrong(None, state)[1] if self.in_begin else state

    def act(self, memory, state):
        self.decisions.append(1)
        action, memory = ConstantVelocity(self.dt).act(memory, state)
        return self.wrong(action, memory) if len(self.decisions) == FAILS_AT and not self.in_begin else (action, memory)


def raising(action, state):
    raise RuntimeError("my\nbug")


def stopping(action, state):
    raise SystemExit("bye")


WRONG = {
    "raises": (raising, "act raised RuntimeError: my bug"),
    "stops": (stopping, "act raised SystemExit: bye"),
    "nan": (lambda action, state: (action * float("nan"), state), "act returned the action [nan], expected finite"),
    "infinite": (
        lambda action, state: (action + float("inf"), state),
        "act returned the action [inf], expected finite",
    ),
    "large": (lambda action, state: (action + 1e30, state), "of at most 1e+06"),
    "shape": (lambda action, state: (action[:, :2], state), ", 2, 1), expected ("),
    "list": (lambda action, state: (action.tolist(), state), "act returned a list as action, expected a tensor"),
    "none": (lambda action, state: None, "act returned None, expected a pair (action, policy state)"),
    "state": (lambda action, state: (action, None), "act returned None as policy state, expected a gri.PolicyState"),
    "graph": (
        lambda action, state: (action, replace(state, graph=InteractionGraph(torch.zeros(9, 6, 2), FOLLOWING))),
        "act returned a graph that is no finite logits of ",
    ),
    "exits": (lambda action, state: os._exit(7), "act ended its process (exit code 7)"),
    "hangs": (lambda action, state: time.sleep(60), "act gave no answer within 1 s"),
}


def driver(policy, limit: float = 1.0) -> Driver:
    return Driver("mine", OwnPolicy(policy, limit))


@pytest.mark.skipif(not CAN_FORK, reason="needs fork")
@pytest.mark.parametrize("how", WRONG)
def test_every_failure_ends_the_groups_with_its_reason_and_time(simulate, short_scenario, how):
    wrong, reason = WRONG[how]
    scenario = msgspec.structs.replace(short_scenario, episodes=4)
    outcome = simulate(scenario, driver(Bad(scenario.step, wrong=wrong)))
    assert len(outcome.episodes) == 4
    for episode in outcome.episodes:
        assert episode.ending is Ending.POLICY_FAILED
        assert not episode.outcome.completed
        failed = [event for event in episode.events if event.kind is EventKind.POLICY_FAILED]
        assert len(failed) == 1
        assert reason in failed[0].detail
        assert failed[0].vehicles == episode.group.ids
        assert failed[0].time == pytest.approx(episode.group.time + (FAILS_AT - 1) * scenario.step)
        assert episode.end == pytest.approx(episode.group.time + FAILS_AT * scenario.step)
    assert all(episode.ending is Ending.HORIZON for episode in outcome.left_to_sumo)


@pytest.mark.skipif(not CAN_FORK, reason="needs fork")
@pytest.mark.parametrize("wrong", [raising, lambda action, state: os._exit(1)], ids=["raises", "exits"])
def test_a_failure_in_begin_ends_all_groups_at_once(simulate, short_scenario, wrong):
    scenario = msgspec.structs.replace(short_scenario, episodes=4)
    outcome = simulate(scenario, driver(Bad(scenario.step, wrong=wrong, in_begin=True)))
    assert {episode.ending for episode in outcome.episodes} == {Ending.POLICY_FAILED}
    assert all(event.detail.startswith("begin ") for event in outcome.episodes[0].events if "policy" in event.kind)


def test_a_group_with_a_bad_number_costs_the_other_groups_nothing(simulate, short_scenario):
    def one_bad(action, state):
        """The first of several groups in one branch; a group that has a branch of its own is left alone."""
        bad = float("nan") if len(action) > 1 else 1.0
        return torch.cat([action[:1] * bad, action[1:]]), state

    good = simulate(short_scenario, driver(ConstantVelocity(short_scenario.step)))
    bad = simulate(short_scenario, driver(Bad(short_scenario.step, wrong=one_bad)))
    pairs = [(a.ending, b.ending) for a, b in zip(bad.episodes, good.episodes, strict=True)]
    failed = [a is Ending.POLICY_FAILED for a, _ in pairs]
    assert 0 < sum(failed) < len(pairs)
    assert all(a is b for (a, b), bad_one in zip(pairs, failed, strict=True) if not bad_one)


def test_an_own_policy_drives_like_any_other(simulate, short_scenario):
    scenario = msgspec.structs.replace(short_scenario, episodes=4)
    plain = simulate(scenario, ConstantVelocity(scenario.step))
    own = simulate(scenario, driver(ConstantVelocity(scenario.step)))
    assert [episode.state.tolist() for episode in own.episodes] == [e.state.tolist() for e in plain.episodes]


def test_errors_of_begin_are_told():
    policy = OwnPolicy(Bad(0.2, wrong=lambda action, state: (None, PolicyState), in_begin=True), 1.0)
    with pytest.raises(PolicyFailure, match="begin returned a type as policy state"):
        policy.begin(Trajectory.complete(torch.zeros(1, 3, 1, 3), 0.2))
