"""Explanations of an episode: their numbers are those of the reward."""

import msgspec
import numpy as np
import pytest
import torch

from cosim.show.explanation import explanation, model_states, terms_of
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
    assert "0 (0) follows </script>1 (1) (p 0.97)" in text
    assert "1.0 s after the take-over, 1 → 0 changes from follow to none (p 0.60)." in text
    assert "driven for 3.0 s; ended by: horizon" in text


def test_it_names_the_largest_terms_with_their_share(episode, run, scenario, reward):
    terms = terms_of(episode, 0, scenario, reward)
    total = sum(term.cost.mean() for term in terms)
    largest = max(terms, key=lambda term: term.cost.mean())
    text = explanation(episode, run)
    assert f"{100 * largest.cost.mean() / total:.0f} % of its cost: {largest.meaning}" in text


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
    assert "gri does not infer a graph." in explanation(episode_view(tables, 0), run)
