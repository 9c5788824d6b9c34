"""Driver models of the benchmark, against equilibria that can be worked out by hand."""

import pytest
import torch

from gri.bench.driver_models import DRIVER_MODELS, FREE, GIPPS, IDM, KRAUSS, LINEAR


def value(x: float) -> torch.Tensor:
    return torch.tensor([[x]], dtype=torch.float64)


def test_idm_keeps_its_speed_at_the_equilibrium_gap():
    """s_eq = (s0 + vT) / sqrt(1 − (v/v0)⁴) = (2 + 15·1.5) / sqrt(1 − 1/16) = 25.303 m."""
    p = {name: value(x) for name, x in {"a": 1.0, "b": 2.0, "T": 1.5, "s0": 2.0, "v0": 30.0}.items()}
    gap = (2 + 15 * 1.5) / (1 - (15 / 30) ** 4) ** 0.5
    assert gap == pytest.approx(25.303, abs=1e-3)
    assert IDM.acceleration(p, value(15.0), value(gap), value(15.0)).item() == pytest.approx(0.0, abs=1e-12)


def test_krauss_drives_at_the_leaders_speed_one_headway_behind():
    """v_safe = v_l + (g − v_l·T)/(...) = v_l where the gap beyond s0 is v_l·T."""
    p = {name: value(x) for name, x in {"a": 1.0, "b": 3.0, "T": 1.0, "s0": 2.0, "v0": 30.0}.items()}
    assert KRAUSS.acceleration(p, value(15.0), value(17.0), value(15.0)).item() == pytest.approx(0.0, abs=1e-12)


def test_gipps_keeps_its_speed_where_it_is_just_safe():
    """(v + bτ)² = b²τ² + b(2·room − vτ) + v² gives room = 1.5·vτ where both brake equally hard."""
    p = {name: value(x) for name, x in {"a": 1.0, "b": 3.0, "b_leader": 3.0, "tau": 1.0, "s0": 2.0, "v0": 60.0}.items()}
    gap = 2 + 1.5 * 15
    assert GIPPS.acceleration(p, value(15.0), value(gap), value(15.0)).item() == pytest.approx(0.0, abs=1e-12)


def test_the_linear_model_is_at_rest_at_its_headway():
    p = {name: value(x) for name, x in {"k0": 0.2, "k1": 0.1, "k2": 0.5, "T": 1.5, "s0": 3.0, "v0": 30.0}.items()}
    assert LINEAR.acceleration(p, value(20.0), value(33.0), value(20.0)).item() == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("model", DRIVER_MODELS, ids=lambda model: model.name)
def test_without_a_leader_a_driver_keeps_its_wished_speed_and_ignores_all_others(model):
    generator = torch.Generator().manual_seed(0)
    p = {**model.draw((50, 1), generator), "v0": torch.full((50, 1), 20.0, dtype=torch.float64)}
    v = torch.full((50, 1), 20.0, dtype=torch.float64)
    alone = model.acceleration(p, v, torch.full_like(v, FREE), torch.full_like(v, 3.0))
    assert alone.abs().max() < 1e-9
    assert torch.equal(alone, model.acceleration(p, v, torch.full_like(v, FREE), torch.full_like(v, 30.0)))


@pytest.mark.parametrize("model", DRIVER_MODELS, ids=lambda model: model.name)
def test_every_driver_brakes_for_a_standing_leader(model):
    generator = torch.Generator().manual_seed(0)
    p = {**model.draw((50, 1), generator), "v0": torch.full((50, 1), 30.0, dtype=torch.float64)}
    v = torch.full((50, 1), 15.0, dtype=torch.float64)
    assert (model.acceleration(p, v, torch.full_like(v, 12.0), torch.zeros_like(v)) < -1.0).all()
