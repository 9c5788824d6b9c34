from pathlib import Path

import msgspec
import pytest
import torch

from gri.core.dynamics import POINT_MASS_1D, POINT_MASS_2D, Dynamics
from gri.core.graph import EdgeType, InteractionGraph, pairs
from gri.core.scenes import Scenes
from gri.data.ranges.recorded import NGSIM_CAR_FOLLOWING, NGSIM_LANE_CHANGING
from gri.data.synthetic.expert import model_config
from gri.errors import InputError
from gri.networks.decoder import DecoderConfig
from gri.networks.encoder import EncoderConfig
from gri.networks.model import RelationalModel
from gri.planning.edge_posterior import marginals
from gri.planning.riccati_likelihood import expand_steps, log_likelihood_by_steps
from gri.rewards.recorded_traffic_features import References
from gri.rewards.structured import NaturalisticConfig, StructuredReward
from gri.training.grounded import recorded_traffic
from gri.training.grounded.recorded_traffic import RecordedSettings, fit_references, train_recorded
from gri.training.grounded.settings import GroundedSettings
from gri.training.train import read_train_config

SMALL = RecordedSettings(
    grounded=GroundedSettings(updates=2, planner_updates=1, planner_batch=4, batch=4, return_batch=4, judge="policy"),
    reward_updates=3,
    reward_batch=4,
)


def driven(start: list[list[float]], action: torch.Tensor, dynamics: Dynamics) -> torch.Tensor:
    """States of scenes that all begin alike."""
    states = [torch.tensor(start).expand(len(action), -1, -1)]
    for t in range(action.shape[2]):
        states.append(dynamics.step(states[-1], action[:, :, t], 0.2))
    return torch.stack(states, 2)


def scenes(count: int = 6, steps: int = 12) -> Scenes:
    """Three vehicles 15 m apart with random jerks."""
    generator = torch.Generator().manual_seed(0)
    action = 0.5 * torch.randn(count, 3, steps - 1, 1, generator=generator)
    state = driven([[0.0, 9.0, 0.0], [15.0, 9.0, 0.0], [30.0, 9.0, 0.0]], action, POINT_MASS_1D)
    graph = InteractionGraph.of_edges(
        {(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW}, NGSIM_CAR_FOLLOWING.vocabulary
    )
    return Scenes(state, action[:, :2], graph.map.expand(count, -1))


def model() -> RelationalModel:
    torch.manual_seed(0)
    decoder = DecoderConfig(kind="recurrent", hidden=8)
    return RelationalModel(model_config(NGSIM_CAR_FOLLOWING, decoder, EncoderConfig(hidden=8)))


def test_references_learn_from_the_likelihood():
    # With headways that differ from what is wanted: where they are equal, ∇√f is read with another precision.
    config = NaturalisticConfig(references=References(speed=12.0, time_headway=0.8))
    reward, data = StructuredReward(config), scenes()
    expansion = expand_steps(model(), reward, data.state, data.action, learn=True)
    value = log_likelihood_by_steps(reward, expansion)
    fixed = log_likelihood_by_steps(reward, expand_steps(model(), reward, data.state, data.action))
    torch.testing.assert_close(value, fixed, rtol=1e-4, atol=1e-3)
    assert reward.references is not None
    slopes = torch.autograd.grad(value.mean(), list(reward.references.parameters()))
    assert all(torch.isfinite(slope).all() for slope in slopes)
    assert all(slope.abs().sum() > 0 for slope in slopes)


def test_the_likelihood_is_not_a_matter_of_rounding():
    # In this random walk paths are so nearly parallel that single precision is 3.5 nats off.
    generator = torch.Generator().manual_seed(4)
    action = torch.randn(64, 3, 29, 2, generator=generator) * torch.tensor([0.5, 0.2])
    start = [[0.0, -3.6, 2.0, 0, 0, 0], [-8.0, 0, 2.0, 0, 0, 0], [8.0, 0, 2.0, 0, 0, 0]]
    state = driven(start, action, POINT_MASS_2D)
    walks = Scenes(state, action[:, :2], torch.zeros(64, 6, dtype=torch.long))[41:42]
    lent = RelationalModel(model_config(NGSIM_LANE_CHANGING, DecoderConfig(kind="recurrent", hidden=8), None))
    torch.manual_seed(0)
    reward = StructuredReward(NGSIM_LANE_CHANGING.reward)
    reward.log_alpha.data.fill_(-3.0)
    expansion = expand_steps(lent, reward, walks.state, walks.action)
    single, exact = (log_likelihood_by_steps(reward, e) for e in (expansion, expansion.double()))
    assert (single - exact).abs().max().item() > 1
    settings = RecordedSettings(grounded=GroundedSettings(no_edge_prior=0.2, ahead_only=True, likelihood="stepwise"))
    posterior = recorded_traffic.recorded_posterior(lent, reward, walks, settings)
    prior = recorded_traffic.recorded_prior(reward, walks.state, settings)
    torch.testing.assert_close(posterior, marginals(reward, exact.float(), prior), rtol=0, atol=1e-3)


def test_the_likelihood_rises():
    reward, data = StructuredReward(NGSIM_CAR_FOLLOWING.reward), scenes()
    lent, heights = model(), []
    settings = RecordedSettings(grounded=SMALL.grounded, reward_updates=25, reward_batch=6, reward_rate=0.05)
    generator = torch.Generator().manual_seed(0)
    fit_references(lent, reward, data, settings, generator, lambda what, done, total, value: heights.append(value))
    assert heights[-1] > heights[0] + 1


def test_rare_speeds_are_drawn_as_often_as_frequent_ones():
    speed = torch.cat([torch.full((80,), 3.0), torch.full((40,), 9.0), torch.full((5,), 17.0)])
    weight = recorded_traffic.speed_balanced_weights(speed, width=2.0)
    share = [float(weight[speed == v].sum()) for v in (3.0, 9.0, 17.0)]
    assert share == pytest.approx([1.0, 1.0, 5 / recorded_traffic.MIN_SCENES_PER_BIN])


def test_scenes_of_all_speeds_make_the_reward(monkeypatch: pytest.MonkeyPatch):
    data = scenes(100)
    data.state[30:, :, :, 1] -= 6.0
    seen, expand = [], recorded_traffic.expand_steps

    def expanded(lent, reward, state, *rest, **options):
        seen.append(state[:, 0, 0, 1] > 6)
        return expand(lent, reward, state, *rest, **options)

    monkeypatch.setattr(recorded_traffic, "expand_steps", expanded)
    for width, fast in ((None, 0.3), (2.0, 0.5)):
        seen.clear()
        settings = RecordedSettings(grounded=SMALL.grounded, reward_updates=1, reward_batch=400, speed_bin=width)
        reward = StructuredReward(NGSIM_CAR_FOLLOWING.reward)
        fit_references(model(), reward, data, settings, torch.Generator().manual_seed(0))
        assert float(seen[0].float().mean()) == pytest.approx(fast, abs=0.1)


def test_all_stages_run_and_repeat():
    results = []
    for _ in range(2):
        trained, reward = model(), StructuredReward(NGSIM_CAR_FOLLOWING.reward)
        train_recorded(trained, reward, scenes(), SMALL, seed=1)
        results.append(torch.cat([p.flatten() for p in trained.parameters()]))
    torch.testing.assert_close(results[0], results[1], rtol=0, atol=0)


def test_graphs_are_learned_from_all_sites_of_a_file(monkeypatch: pytest.MonkeyPatch):
    data = scenes(20)
    data.state[10:, :, :, 1] += 100.0  # the second site
    judged = []

    def posterior(model, reward, some, *rest) -> torch.Tensor:
        judged.append(some.state[:, 0, 0, 1] > 50)
        return torch.full((len(some), 6, 2), 0.5)

    monkeypatch.setattr(recorded_traffic, "fit_references", lambda *arguments: None)
    monkeypatch.setattr(recorded_traffic, "recorded_posterior", posterior)
    grounded = GroundedSettings(updates=1, graph_scenes=10, batch=2, return_batch=2)
    lent, reward = model(), StructuredReward(NGSIM_CAR_FOLLOWING.reward)
    train_recorded(lent, reward, data, RecordedSettings(grounded=grounded), seed=0)
    assert 0 < int(judged[0].sum()) < 10


def test_lanes_define_who_follows_and_who_yields():
    # 0 comes from the lane beside and ends between 1, behind it, and 2, ahead of it.
    state = torch.zeros(1, 3, 2, 6)
    state[0, :, 0, :2] = torch.tensor([[10.0, -3.6], [0.0, 0.0], [30.0, 0.3]])
    state[0, :, 1, :2] = torch.tensor([[50.0, 0.0], [40.0, 0.0], [70.0, 0.0]])
    reward = StructuredReward(NGSIM_LANE_CHANGING.reward)
    settings = RecordedSettings(grounded=GroundedSettings(no_edge_prior=0.8, ahead_only=True))
    prior = recorded_traffic.recorded_prior(reward, state, settings)[0]
    possible = {
        pair: {str(k) for k, p in zip(reward.vocabulary, row.tolist(), strict=True) if p > 1e-6}
        for pair, row in zip(pairs(3), prior, strict=True)
    }
    assert possible == {
        (0, 1): {"none", "yield"}, (0, 2): {"none"}, (1, 0): {"none"},
        (1, 2): {"none"}, (2, 0): {"none", "yield"}, (2, 1): {"none", "follow"},
    }  # fmt: skip
    torch.testing.assert_close(prior.sum(-1), torch.ones(6))
    assert float(prior[pairs(3).index((2, 0)), 0]) == pytest.approx(0.8 / 0.9)
    settings = msgspec.structs.replace(settings, no_follow_prior=0.02)
    following = recorded_traffic.recorded_prior(reward, state, settings)[0]
    changed = (following != prior).any(-1)
    assert [pair for pair, is_changed in zip(pairs(3), changed, strict=True) if is_changed] == [(2, 1)]
    assert following[changed][0, :2].tolist() == pytest.approx([0.02, 0.98])


def test_a_prior_is_a_probability(tmp_path: Path):
    path = tmp_path / "own.yaml"
    objective = "{type: gri_recorded, grounded: {type: gri}, no_follow_prior: 1.0}"
    path.write_text(f"name: own\ndata: {{range: ngsim_lane_changing, graphs: mixed}}\nobjective: {objective}\n")
    with pytest.raises(InputError, match=r"own.yaml:3: field objective.no_follow_prior: expected `float` < 1.0"):
        read_train_config(path)


def test_in_car_following_only_the_next_vehicle_ahead_is_followed():
    reward, data = StructuredReward(NGSIM_CAR_FOLLOWING.reward), scenes(2)
    prior = recorded_traffic.recorded_prior(reward, data.state, RecordedSettings(grounded=GroundedSettings()))
    torch.testing.assert_close(prior, torch.tensor([0.9, 0.1]).expand(2, 6, 2))
    ahead = RecordedSettings(grounded=GroundedSettings(ahead_only=True))
    nearest = recorded_traffic.recorded_prior(reward, data.state, ahead)
    follows = [0.1 if pair in ((1, 0), (2, 1)) else 0.0 for pair in pairs(3)]  # of three in a row, not 2 -> 0
    torch.testing.assert_close(nearest[..., 1], torch.tensor(follows).expand(2, 6), atol=1e-6, rtol=0)


def test_a_flat_prior_has_the_same_odds_for_every_pair():
    reward = StructuredReward(NaturalisticConfig())
    settings = RecordedSettings(grounded=GroundedSettings(no_edge_prior=0.9, ahead_only=True), by_definition=False)
    prior = recorded_traffic.recorded_prior(reward, torch.randn(4, 3, 5, 3), settings)
    torch.testing.assert_close(prior, torch.tensor([0.9, 0.1]).expand(4, 6, 2))
