"""Policies that drive many vehicles, each behind the next one ahead."""

import numpy as np
import torch

from cosim.loop.pair_policy import PlainPairs, RelationalPairs
from cosim.spec.scenario import Enforced, GroundTruth, Inferred
from gri import checkpoint
from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph
from gri.core.policy import IntelligentDriver, PolicyState
from gri.core.trajectory import Trajectory

MODEL = checkpoint.load("us101_car_following")
STATES = np.array([[[-20.0, 10.0, 0.0], [0.0, 6.0, -1.0]], [[-9.0, 8.0, 0.5], [0.0, 9.0, 0.0]]])


def history(steps: int) -> Trajectory:
    """Both scenes at constant speed."""
    states = torch.tensor(STATES, dtype=torch.float32)[:, :, None].repeat(1, 1, steps, 1)
    ages = torch.arange(steps - 1, -1, -1) * 0.2
    states[..., 0] -= ages * states[..., 1]
    return Trajectory.complete(states, 0.2)


def alone(edge: EdgeType) -> list[float]:
    """What the model does in each scene with this edge on vehicle 0, asked the plain way."""
    graph = InteractionGraph.of_edges({(1, 0): edge}, FOLLOWING, n=2, batch=2)
    state = torch.tensor(STATES, dtype=torch.float32)
    return MODEL.act(PolicyState(graph, MODEL.memory(state)), state)[0][:, 0, 0].tolist()


@torch.inference_mode()
def test_a_new_pair_is_followed_and_driven_as_the_model_drives_it_alone() -> None:
    pairs = RelationalPairs(MODEL, Inferred())
    assert not pairs.begin(np.array([5, 2]), 32).any()
    np.testing.assert_allclose(pairs.act(np.array([5, 2]), STATES), alone(EdgeType.FOLLOW), rtol=1e-5)
    np.testing.assert_allclose(pairs.act(np.array([2]), STATES[1:]), alone(EdgeType.FOLLOW)[1:], rtol=1e-5)


@torch.inference_mode()
def test_after_an_inference_the_pair_is_driven_under_the_inferred_graph() -> None:
    pairs = RelationalPairs(MODEL, Inferred())
    pairs.begin(np.array([0, 1]), 32)
    found = pairs.read(np.array([0, 1]), history(MODEL.history_steps), 5.0)
    assert found is not None
    expected = [alone(EdgeType.FOLLOW if p >= 0.5 else EdgeType.NONE)[k] for k, p in enumerate(found.follows)]
    np.testing.assert_allclose(pairs.act(np.array([0, 1]), STATES), expected, rtol=1e-5)
    assert abs(alone(EdgeType.FOLLOW)[0] - alone(EdgeType.NONE)[0]) > 0.01  # the edge matters


@torch.inference_mode()
def test_an_inference_is_evidence_for_the_last_graph_unless_smoothing_is_off() -> None:
    def follows(source: Inferred) -> float:
        pairs = RelationalPairs(MODEL, source)
        pairs.begin(np.array([0, 1]), 32)
        found = pairs.read(np.array([0, 1]), history(MODEL.history_steps), 5.0)
        assert found is not None
        return found.follows.min()

    assert follows(Inferred()) > follows(Inferred(smoothing=False))


@torch.inference_mode()
def test_a_prescribed_graph_is_never_inferred() -> None:
    for source, edge in (
        (GroundTruth(), EdgeType.FOLLOW),
        (Enforced(edges={}, others="none"), EdgeType.NONE),
        (Enforced(edges={"1->0": "none"}), EdgeType.NONE),
    ):
        pairs = RelationalPairs(MODEL, source)
        pairs.begin(np.array([0, 1]), 32)
        assert pairs.read(np.array([0, 1]), history(MODEL.history_steps), 5.0) is None
        np.testing.assert_allclose(pairs.act(np.array([0, 1]), STATES), alone(edge), rtol=1e-5)


@torch.inference_mode()
def test_plain_policies_keep_the_state_of_each_scene() -> None:
    class Counting(IntelligentDriver):
        """Brakes harder with every step of a scene."""

        def begin(self, history):
            return PolicyState(None, torch.zeros(*history.state.shape[:2], 1))

        def act(self, memory, state):
            later = PolicyState(None, memory.memory + 1)
            return -later.memory, later

    pairs = PlainPairs(Counting(0.2))
    pairs.read(np.array([7, 3]), history(1), 1.0)
    assert pairs.act(np.array([7, 3]), STATES).tolist() == [-1.0, -1.0]
    assert pairs.act(np.array([3]), STATES[:1]).tolist() == [-2.0]
    pairs.read(np.array([9]), Trajectory.complete(history(1).state[:1], 0.2), 1.0)
    assert pairs.act(np.array([9, 3]), STATES).tolist() == [-1.0, -3.0]
