"""How often SUMO's drivers decide."""

import pytest

from cosim.scenes.driver_models import DRIVER_MODELS, decision_steps, model_of, steps_per_decision, with_imprecision
from cosim.world.snapshot import DriverParameters

DRIVER = DriverParameters(kind="big.car.3", length=5.0, width=2.0, acceleration=2.0, imperfection=0.1, action_step=0.2,
                          speed_factor=1.0, max_speed=30.0)  # fmt: skip


@pytest.mark.parametrize(
    ("reaction", "action", "dt", "steps"),
    [(0.0, 0.2, 0.2, 1), (0.5, 0.2, 0.2, 3), (0.5, 0.1, 0.1, 5), (0.0, 0.6, 0.2, 3), (0.5, 0.6, 0.2, 9)],
)
def test_steps_from_decision_to_decision(reaction: float, action: float, dt: float, steps: int):
    assert steps_per_decision(reaction, action, dt) == steps


def test_only_the_answer_to_a_leader_has_a_reaction_time():
    model = model_of(DRIVER, {"big.car": "EIDM"})
    assert decision_steps(DRIVER, model, 0.2) == {"effect_of_leader": 3, "effect_of_requests": 1}
    assert with_imprecision(DRIVER, model).imperfection == model.imprecision > 0.1
    assert with_imprecision(DRIVER, DRIVER_MODELS["Krauss"]) == DRIVER
