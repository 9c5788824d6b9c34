"""Explanations of an episode: their numbers are those of the reward."""

import msgspec
import numpy as np
import pytest
import torch

from cosim.show.action_effects import Effect
from cosim.show.explanation import _why, explanation, model_states, terms_of
from cosim.spec.loading import load_scenario
from gri import checkpoint
from gri.core.graph import EdgeType, InteractionGraph


@pytest.fixture(scope="module")
def reward():
    reward = checkpoint.load_reward("us101_car_following")
    assert reward is not None
    return reward


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("us101_car_following")


def test_the_terms_add_up_to_the_reward(episode, scenario, reward):
    state, action = model_states(episode, scenario)
    chain = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW}, reward.vocabulary)
    whole = reward(state[None], action[None], chain.one_hot)[0]
    for role in range(2):
        terms = terms_of(episode, role, scenario, reward)
        assert {term.sender for term in terms} == {None, role + 1}
        total = sum(term.cost for term in terms)
        np.testing.assert_allclose(total, -whole[role].numpy(), rtol=1e-4)
        assert all((term.cost >= 0).all() for term in terms)


def test_states_are_the_models_own(episode, scenario):
    """Headways are net gap plus 5 m, and the jerks lead from each state to the next acceleration."""
    state, action = model_states(episode, scenario)
    rows = np.flatnonzero(episode.during_drive)
    np.testing.assert_allclose(state[1, :, 0] - state[0, :, 0], episode.gap[rows[:-1], 0] + 5.0, atol=1e-4)
    jerk = np.diff(episode.feature("a")[rows, 0]) / 0.2
    torch.testing.assert_close(action[0, :, 0], torch.from_numpy(jerk).float(), atol=1e-3, rtol=0)


@pytest.fixture
def run(tmp_path, scenario):
    (tmp_path / "scenario.json").write_bytes(msgspec.json.encode(scenario))
    return tmp_path


def test_it_names_the_inferred_graph_and_its_changes(episode, run):
    text = explanation(episode, run)
    assert all(len(line) <= 80 for line in text.splitlines())
    assert "0 (0) follows </script>1 (1) (p 0.97)" in text
    assert "1.0 s after the take-over, 1 → 0 changes from follow to none (p 0.60)." in text
    assert "driven for 3.0 s; ended by: horizon" in text


def test_it_names_the_largest_terms_with_their_share(episode, run, scenario, reward):
    terms = terms_of(episode, 0, scenario, reward)
    total = sum(term.cost.mean() for term in terms)
    largest = max(terms, key=lambda term: term.cost.mean())
    text = " ".join(explanation(episode, run).split())
    assert f"{100 * largest.cost.mean() / total:.0f} % {largest.meaning} (" in text


def test_another_drive_gets_another_explanation(tables, run):
    from cosim.show.episode_view import episode_view

    first = explanation(episode_view(tables, 0), run)
    tables["steps"]["v"] += 2.0 * tables["steps"]["during_drive"]
    assert explanation(episode_view(tables, 0), run) != first


def test_drivers_without_a_graph_or_a_reward_say_so(tables, run, scenario):
    from cosim.show.episode_view import episode_view
    from cosim.spec.scenario import Idm

    idm = msgspec.structs.replace(scenario, policy=Idm())
    (run / "scenario.json").write_bytes(msgspec.json.encode(idm))
    assert "has no reward" in explanation(episode_view(tables, 0), run)
    tables["graphs"] = tables["graphs"].head(0)
    assert "GRI does not infer a graph." in explanation(episode_view(tables, 0), run)


def effect(reason: str, second: list[float], agrees: bool = True) -> Effect:
    time, values = np.array([12.2, 12.4, 12.6, 13.0]), np.array(second)
    acceleration = np.array([-0.6, -1.8, -0.6, 0.0])
    return Effect(1, reason, time, acceleration, values / 5, values, 0 * values, np.full(4, agrees))


def test_it_says_what_the_vehicle_would_have_done_without_an_edge():
    lines = list(_why([effect("follow 0", [-1.0, -2.2, -1.5, 0.0]), effect("yield 2", [0.0, 0.0, 0.0, 0.01])]))
    assert "`follow 0` −1.2 m/s², `yield 2` 0.0 m/s²." in lines[0]
    assert "`yield 2` did not matter: it changed the acceleration by 0.01 m/s² at most." in lines[1]
    assert lines[2] == (
        "  At 12.4 s it braked at −1.8 m/s². Without `follow 0` it would have accelerated at +0.4 m/s²: the edge took"
        " 2.2 m/s² (−0.4 m/s² in the last decision)."
    )
    assert len(lines) == 3, "other moments are too near"


def test_a_drive_that_is_not_its_own_is_not_explained():
    assert "So no reasons are given." in " ".join(_why([effect("follow 0", [-1.0, -2.2, -1.5, 0.0], agrees=False)]))
    assert "No edge leads to it" in " ".join(_why([]))
