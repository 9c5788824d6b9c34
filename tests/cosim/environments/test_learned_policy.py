"""A learned network as a policy: written, read, and driven in a run."""

import numpy as np
import pytest
import torch

from cosim.environments.actions import action_of
from cosim.environments.learned_policy import network_policy, save_network
from cosim.environments.observation import features_of, names_of, observe
from gri.core.dynamics import DUBINS, POINT_MASS_1D
from gri.core.nearby import Nearby
from gri.core.policy import PolicyState
from gri.errors import InputError

STATE = np.array([[[-20.0, -3.6, 12.0, 0.02, 0.5, 0.01], [-32.0, 0.1, 11.0, 0, 0.2, 0], [0.0, 0.0, 13.0, 0, -0.1, 0]]])


@pytest.fixture
def network(tmp_path):
    """A file with a network of two layers, and its layers."""
    random = np.random.default_rng(1)
    inputs = len(features_of(0, DUBINS))
    layers = [(random.normal(size=(6, inputs)), random.normal(size=6)), (random.normal(size=(2, 6)), np.zeros(2))]
    save_network(tmp_path / "net.npz", layers, dynamics="dubins", dt=0.2)
    return tmp_path / "net.npz", layers


def test_the_file_holds_the_network(network):
    path, ((w0, b0), (w1, b1)) = network
    policy = network_policy(0.2, str(path))
    action, _ = policy.act(PolicyState(None, torch.zeros(1, 3, 0)), torch.from_numpy(STATE.astype(np.float32)))
    numbers = w1 @ np.tanh(w0 @ observe(STATE, 0, DUBINS)[0] + b0) + b1
    wanted = action_of(numbers, STATE[0, 0], "targets", DUBINS, 0.2)
    assert action[0, 0].numpy() == pytest.approx(wanted, rel=1e-4)
    others, _ = policy.others.act(PolicyState(None, torch.zeros(1, 3, 0)), torch.from_numpy(STATE.astype(np.float32)))
    assert (action[0, 1:] == others[0, 1:]).all()


def test_everybody_near_is_observed_by_place():
    """The nearest ones in the path, on the left and on the right; the rest of their places are empty."""
    places = {"lead": (25.0, 0.2, 8.0), "far": (60.0, 0.0, 9.0), "left": (-20.0, 3.6, 14.0), "right": (9.0, -3.6, 12.0)}
    ahead, across, v = (torch.tensor([value], dtype=torch.float32) for value in zip(*places.values(), strict=True))
    size = torch.full((1, 4), 5.0)
    near = Nearby(
        ahead[:, None].repeat(1, 3, 1),
        across[:, None].repeat(1, 3, 1),
        v,
        size,
        0.4 * size,
        torch.tensor([[True, True, True, True]]),
        torch.tensor([[80.0, 95.0, 60.0]]),
    )
    found = dict(zip(names_of(0, DUBINS, "everybody"), observe(STATE, 0, DUBINS, near)[0], strict=True))
    assert list(found.values())[:13] == pytest.approx(observe(STATE, 0, DUBINS)[0])
    nobody = {f"{place}.gap": 100 / 30 for place in ("path.behind", "left.ahead", "right.behind")}
    nobody |= {f"{place}.v": 0.0 for place in ("path.behind", "left.ahead", "right.behind")}
    there = {"lane_left": 0.8, "path.ahead.gap": 20 / 30, "path.ahead.v": -0.8, "left.behind.gap": 15 / 30}
    there |= {"left.behind.v": 0.4, "right.ahead.gap": 4 / 30, "right.ahead.v": 0.0}
    assert {name: found[name] for name in there} == pytest.approx(there)
    assert {name: found[name] for name in nobody} == pytest.approx(nobody)
    assert {*there, *nobody} == {*found} - {*names_of(0, DUBINS, "group")}


def test_a_network_that_sees_everybody_says_so_in_its_file(tmp_path):
    inputs = len(names_of(0, DUBINS, "everybody"))
    save_network(
        tmp_path / "n.npz", [(np.zeros((2, inputs)), np.zeros(2))], dynamics="dubins", dt=0.2, sees="everybody"
    )
    assert network_policy(0.2, str(tmp_path / "n.npz")).sees_nearby


def test_a_file_for_another_step_or_of_another_kind_is_an_input_error(network, tmp_path):
    with pytest.raises(InputError, match=r"step: got 0\.1 s"):
        network_policy(0.1, str(network[0]))
    with pytest.raises(InputError, match="no file"):
        network_policy(0.2, str(tmp_path / "none.npz"))
    (tmp_path / "text.npz").write_text("no network")
    with pytest.raises(InputError, match="not a file of save_network"):
        network_policy(0.2, str(tmp_path / "text.npz"))
    save_network(tmp_path / "small.npz", [(np.zeros((2, 3)), np.zeros(2))], dynamics="dubins", dt=0.2)
    with pytest.raises(InputError, match="network of 3 to 2 numbers, expected 13 to 2"):
        network_policy(0.2, str(tmp_path / "small.npz"))


def test_targets_are_reached():
    """The acceleration within one step, the lateral position after some seconds."""
    state = STATE[0, 0]
    numbers = np.array([-0.1, 0.5])
    first = action_of(numbers, state, "targets", DUBINS, 0.2)
    assert state[4] + 0.2 * first[0] == pytest.approx(-0.5)
    for _ in range(60):
        state = DUBINS.step(state, action_of(numbers, state, "targets", DUBINS, 0.2), 0.2)
    assert state[1] == pytest.approx(-0.25 * 3.66, abs=0.05)
    assert action_of(np.array([1.0]), np.array([0.0, 9.0, 0.5]), "targets", POINT_MASS_1D, 0.2) == pytest.approx(10.0)


def test_actions_of_the_dynamics_are_scaled_and_bounded():
    action = action_of(np.array([0.5, -3.0]), STATE[0, 0], "dynamics", DUBINS, 0.2)
    assert action == pytest.approx([7.5, -1.0])


def test_observations_are_what_the_page_says():
    """Own y, v, heading, a, yaw rate; then x, y, v, a of both others, x and v relative."""
    found = observe(STATE[0], 0, DUBINS)
    wanted = [-0.9, 0.8, 0.1, 0.5 / 3, 0.05, -0.4, 0.025, -0.2, 0.2 / 3, 20 / 30, 0.0, 0.2, -0.1 / 3]
    assert found == pytest.approx(wanted, abs=1e-6)
    far = STATE[0].copy()
    far[2, 0] = 1e4
    assert observe(far, 0, DUBINS)[9] == 10.0
