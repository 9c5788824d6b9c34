"""What a policy is shown: perturbed sensors reach the history, and with it every inference of the graph."""

from dataclasses import dataclass, field

import msgspec
import pytest
import torch

from cosim.loop.driving import Driver
from cosim.runs.policy_loading import policy_of
from cosim.spec.perturbations import KINDS
from gri.core.policy import ConstantVelocity
from gri.core.trajectory import Trajectory


@dataclass(frozen=True)
class Watching(ConstantVelocity):
    """Remembers the histories from which it was to infer a graph; the first inference is made before any branch."""

    history_steps: int = 20
    histories: list[torch.Tensor] = field(default_factory=list)

    def begin(self, history: Trajectory):
        self.histories.append(history.state.clone())
        return super().begin(history)


@pytest.fixture(scope="module")
def scenario(short_scenario):
    return msgspec.structs.replace(short_scenario, episodes=2, groups_at_once=2, horizon=1.0, watch=0.0)


def first_history(scenario, simulate, **perturbations: float) -> torch.Tensor:
    """The history of the first round, of shape (views · G, 3, T, features)."""
    specs = tuple(KINDS[kind](intensity=intensity) for kind, intensity in perturbations.items())
    policy = Watching(0.2)
    simulate(msgspec.structs.replace(scenario, perturbations=specs), policy)
    assert all(bool(torch.isfinite(history).all()) for history in policy.histories)
    return policy.histories[0]


def test_the_first_inference_sees_noise(scenario, simulate):
    plain, noisy = first_history(scenario, simulate), first_history(scenario, simulate, observation_noise=2.0)
    error = (noisy - plain)[..., 1]  # of the speed: positions are relative to the noisy position of the leader
    assert error.std().item() == pytest.approx(1.0, rel=0.25)
    assert torch.equal(noisy[..., 2], plain[..., 2])


def test_the_first_inference_sees_what_was_received_last(scenario, simulate):
    plain, blind = first_history(scenario, simulate), first_history(scenario, simulate, dropout=1.0)
    assert (blind[..., 1] == blind[..., :1, 1]).all()
    assert (plain[..., 1] != plain[..., :1, 1]).any()


def test_the_first_inference_sees_others_late_in_a_view_of_its_own(scenario, simulate):
    """Two views, first that of vehicle 0 and then that of vehicle 1; 0.6 s are three steps."""
    plain, late = first_history(scenario, simulate), first_history(scenario, simulate, perception_latency=0.6)
    groups = len(plain)
    assert len(late) == 2 * groups
    of_0, of_1 = late[:groups], late[groups:]
    for view, own, other in ((of_0, 0, 1), (of_1, 1, 0)):
        assert torch.equal(view[:, own, :, 1], plain[:, own, :, 1])
        assert torch.equal(view[:, other, 3:, 1], plain[:, other, :-3, 1])
        assert torch.equal(view[:, 2, 3:, 1], plain[:, 2, :-3, 1])


def test_without_perturbations_there_is_one_view_of_the_undisturbed_history(scenario, simulate):
    plain = first_history(scenario, simulate)
    neutral = first_history(scenario, simulate, observation_noise=0.0, dropout=0.0, headway_ratio=0.0)
    assert torch.equal(plain, neutral)
    both = first_history(scenario, simulate, perception_latency=0.0, localization_latency=0.0)
    assert torch.equal(both, torch.cat([plain, plain]))


def test_views_have_graphs_of_their_own_and_the_episode_one_per_inference(scenario, simulate):
    policy = policy_of(scenario)
    assert policy is not None
    specs = (KINDS["perception_latency"](intensity=0.4), KINDS["observation_noise"](intensity=1.0))
    noisy = msgspec.structs.replace(scenario, perturbations=specs)
    (first, *_) = simulate(noisy, Driver("gri", policy, reinfer=2)).episodes
    (plain, *_) = simulate(scenario, Driver("gri", policy, reinfer=2)).episodes
    assert first.graph is not None
    assert plain.graph is not None
    assert len(first.graph) == len(first.graph_time) == 3  # at the take-over, after 0.4 s and after 0.8 s
    assert first.group == plain.group
    assert not torch.equal(first.graph.logits[0], plain.graph.logits[0])  # the very first inference is disturbed
