"""Groups of one branch do not act on each other, and what nothing acts on moves exactly as in the counterpart."""

import numpy as np
import pytest
from msgspec.structs import replace

from cosim.loop.vehicles_ahead import SpeedRecord
from cosim.spec.loading import load_scenario
from cosim.sumo import simulation
from cosim.world.counterparts import leader_deviation
from cosim.world.episode import COLUMNS
from gri.core.policy import ConstantVelocity, IntelligentDriver

S = COLUMNS.index("s")
EXACT = 1e-9  # [m]


class Brakes(ConstantVelocity):
    """Brakes at 2 m/s², whatever is ahead: everything behind it moves differently."""

    def act(self, memory, state):
        return (-2.0 - state[..., 2:3]) / self.dt, memory


def settled(name: str, episodes: int):
    """A shipped scenario with two minutes of warm-up, so that its lanes are full."""
    scenario = load_scenario(name)
    bottleneck = scenario.traffic.bottleneck
    if bottleneck.hold is not None:  # active before the first round
        bottleneck = replace(bottleneck, hold=replace(bottleneck.hold, start=60.0))
    traffic = replace(scenario.traffic, warm_up=120.0, bottleneck=bottleneck)
    return replace(scenario, traffic=traffic, episodes=episodes, watch=1.0, surroundings=False)


def deviations(outcome) -> np.ndarray:
    return np.array([leader_deviation(*pair) for pair in zip(outcome.episodes, outcome.left_to_sumo, strict=True)])


@pytest.mark.parametrize("name", ["us101_car_following", "i80_car_following", "us101_lively"])
def test_an_undriven_leader_moves_exactly_as_in_its_counterpart(name, simulate):
    """For the whole drive, in several rounds of several groups, also where the driven vehicles brake for no reason."""
    outcome = simulate(settled(name, 12), Brakes(0.2))
    rounds = {episode.group.time for episode in outcome.episodes}
    assert len(rounds) >= 2
    assert len(outcome.episodes) > len(rounds)
    assert (deviations(outcome) <= EXACT).all()
    for driven, left in zip(outcome.episodes, outcome.left_to_sumo, strict=True):
        n = min(len(driven.time), len(left.time))
        assert np.abs(driven.state[:n, 1, S] - left.state[:n, 1, S]).max() > 0.5  # the policy did change the traffic


def test_without_the_recorded_speeds_leaders_deviate(simulate, monkeypatch):
    """SUMO's random numbers are per lane: what drives behind changes how a leader dawdles."""
    monkeypatch.setattr(SpeedRecord, "repeat", lambda *_: None)
    found = deviations(simulate(settled("us101_car_following", 12), Brakes(0.2)))
    assert (found > EXACT).any()
    assert found.max() < 1.0  # no group drives behind another one of its branch


def test_every_policy_gets_the_same_starts_until_the_end(short_scenario, simulate):
    """Also in the last round, and however many groups a policy breaks up."""
    scenario = replace(short_scenario, episodes=5)
    outcomes = [simulate(scenario, policy) for policy in (IntelligentDriver(0.2), Brakes(0.2), None)]
    starts = [[episode.group for episode in outcome.episodes] for outcome in outcomes]
    assert [len(groups) for groups in starts] == [5, 5, 5]
    assert starts[0] == starts[1] == starts[2]
    assert len({outcome.simulated for outcome in outcomes}) == 1


def test_reports_of_sumo_are_counted_in_every_step(short_scenario, simulate, monkeypatch):
    """A collision that SUMO reports all the time counts in the steps of rounds, too, and apart from the branches'."""

    class Hit:
        collider, victim = "a", "b"

    monkeypatch.setattr(simulation, "_collisions", lambda: [Hit])
    outcome = simulate(replace(short_scenario, episodes=2), IntelligentDriver(0.2))
    assert outcome.trunk.collision_steps == round(outcome.simulated / short_scenario.step)
    driven = short_scenario.steps(short_scenario.horizon + short_scenario.watch)
    assert outcome.branches.collision_steps >= driven
    assert outcome.branches.collision_steps % driven == 0
    assert outcome.trunk.teleports == outcome.branches.teleports == 0
