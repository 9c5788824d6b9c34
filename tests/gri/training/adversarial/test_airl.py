from math import log
from pathlib import Path
from typing import Any

import msgspec
import pytest
import torch
from torch.nn.functional import softplus

from gri.data.ranges.recorded import NGSIM_CAR_FOLLOWING
from gri.errors import InputError
from gri.resources import shipped
from gri.rewards.structured import NaturalisticConfig, RewardConfig
from gri.training.adversarial.airl import (
    FIXED_RATIONALITY,
    edge_gradient,
    expert_objective,
    squared_logit_differences,
    with_fixed_rationality,
)
from gri.training.adversarial.discriminator import airl_logit, discriminator_loss
from gri.training.optimisation import Bottleneck, updated_beta
from gri.training.train import read_train_config


def test_logit_is_that_of_the_papers_discriminator():
    f, log_pi = torch.tensor(-0.3, dtype=torch.float64), torch.tensor(-1.2, dtype=torch.float64)
    d = f.exp() / (f.exp() + log_pi.exp())
    torch.testing.assert_close(airl_logit(f, log_pi), d.log() - (1 - d).log())


def test_discriminator_loss_by_hand():
    expert, generated = torch.full((1, 1, 1), log(3.0)), torch.full((1, 1, 1), log(1 / 4))
    # D(E) = 3/4, D(G) = 1/5
    torch.testing.assert_close(discriminator_loss(expert, generated), torch.tensor(-log(0.75) - log(0.8)))


def test_the_literal_slope_is_the_derivative_of_the_loss():
    f_expert, f_generated = torch.randn(2, 6, 5, 1), torch.randn(2, 6, 5, 1)
    rest_expert, rest_generated = torch.randn(2, 6, 5), torch.randn(2, 6, 5)
    z = torch.ones(2, 6, 1, requires_grad=True)
    expert = rest_expert + (f_expert * z[:, :, None]).sum(-1)
    generated = rest_generated + (f_generated * z[:, :, None]).sum(-1)
    (softplus(-expert) + softplus(generated)).sum().backward()
    slope = edge_gradient(f_expert, f_generated, (-expert).sigmoid(), generated.sigmoid(), clip=1e9)
    torch.testing.assert_close(slope, z.grad)


def test_slopes_are_clipped():
    ones = torch.ones(1, 1, 100)
    slope = edge_gradient(torch.ones(1, 1, 100, 1), torch.zeros(1, 1, 100, 1), ones, ones, clip=5.0)
    assert slope.tolist() == [[[-5.0]]]


@pytest.mark.parametrize(("form", "expected"), [("printed", 0.25), ("accumulating", 1.25)])
def test_beta(form: str, expected: float):
    bottleneck = Bottleneck(form=form, rate=0.5, information=0.5)  # type: ignore[arg-type]
    assert updated_beta(1.0, 1.0, bottleneck) == expected
    assert updated_beta(0.0, 0.0, bottleneck) == 0.0


def test_the_experts_half_of_j_loses_its_slope_where_d_is_sure_and_the_contrast_form_does_not():
    f = torch.zeros(2)
    log_pi = torch.tensor([0.0, -20.0], requires_grad=True)
    literal = expert_objective(f, log_pi, "literal")
    torch.testing.assert_close(literal[0], torch.tensor(log(2.0)))  # -log D with D = 1/2
    (slope,) = torch.autograd.grad(literal.sum(), log_pi)
    torch.testing.assert_close(slope, torch.tensor([0.5, 0.0]), atol=1e-6, rtol=0)
    (slope,) = torch.autograd.grad(expert_objective(f, log_pi, "contrast").sum(), log_pi)
    assert slope.tolist() == [1.0, 1.0]


def test_the_penalty_is_on_differences_of_logits():
    logits = torch.tensor([[[1.0, 4.0], [2.0, 2.0]], [[0.0, 1.0], [5.0, 4.0]]])
    assert float(squared_logit_differences(logits)) == (9 + 0 + 1 + 1) / 2
    assert float(squared_logit_differences(logits + 7)) == float(squared_logit_differences(logits))


@pytest.mark.parametrize(("field", "value"), [("start", "{}"), ("weights", "{node: {speed: 1.5}}")])
def test_what_rewards_without_named_terms_have_no_use_for_is_refused(tmp_path: Path, field: str, value: str):
    path = tmp_path / "own.yaml"
    objective = f"{{type: airl, {field}: {value}, rewards: networks}}"
    path.write_text(f"name: own\ndata: {{range: paper, graphs: one}}\nobjective: {objective}\n")
    with pytest.raises(InputError, match=rf"own.yaml: field objective.{field}: got rewards: networks"):
        read_train_config(path)


def test_ablations_may_begin_with_a_policy_that_is_planned_on_the_semantic_reward(tmp_path: Path):
    path = tmp_path / "own.yaml"
    objective = "{type: airl, rewards: networks, start: {on_semantic_reward: true}}"
    path.write_text(f"name: own\ndata: {{range: paper, graphs: one}}\nobjective: {objective}\n")
    assert read_train_config(path).objective.start.on_semantic_reward  # type: ignore[union-attr]


def test_every_ablation_changes_one_thing_of_the_contrast_row():
    for prefix in ("paper_car_following", "lane_changing"):
        contrast, literal, networks, alike = (
            msgspec.to_builtins(read_train_config(shipped("scenarios", "train", f"{prefix}_airl{suffix}.yaml")))
            for suffix in ("", "_with_literal", "_with_networks", "_with_networks_all_alike")
        )
        assert changes(contrast, literal) == {"name", "objective.encoder"}
        networks_only = {"name", "objective.rewards", "objective.start.on_semantic_reward"}
        assert changes(contrast, networks) == networks_only
        assert changes(networks, alike) == {"name", "objective.relations"}


def changes(one: dict[str, Any], other: dict[str, Any], under: str = "") -> set[str]:
    """Names of the fields whose values differ."""
    found = set()
    for name in one.keys() | other.keys():
        before, after = one.get(name), other.get(name)
        if isinstance(before, dict) and isinstance(after, dict):
            found |= changes(before, after, f"{under}{name}.")
        elif before != after:
            found.add(under + name)
    return found


def test_rewards_of_recorded_traffic_are_scaled_in_the_game_and_others_are_not():
    assert with_fixed_rationality(NGSIM_CAR_FOLLOWING.reward) == NaturalisticConfig(temperature=FIXED_RATIONALITY)
    assert with_fixed_rationality(RewardConfig()) == RewardConfig()
