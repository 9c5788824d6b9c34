"""The table and the text of effects, and the delay between two series."""

import numpy as np
import pytest

from cosim.perturb.effects import Effect, delay_between, effects_table, shown_effects


def test_effects_are_means_over_groups():
    table = effects_table(
        [
            Effect("dropout", 0.4, "share of missing states", "", 0.4, 0.3, 0.0),
            Effect("dropout", 0.4, "share of missing states", "", 0.4, 0.5, 0.0),
            Effect("dropout", 0.6, "share of missing states", "", 0.6, np.nan, 0.0),
            Effect("denser_traffic", 1.2, "density", "veh/km", 240.0, 230.0, 200.0, "the road is full"),
        ]
    )
    assert table["measured"].tolist() == pytest.approx([0.4, np.nan, 230.0], nan_ok=True)
    assert table["groups"].tolist() == [2, 0, 1]
    assert table["remark"].tolist() == ["", "", "the road is full"]
    assert table["stated"].tolist() == [0.4, 0.6, 240.0]


def test_without_perturbations_there_is_no_effect():
    assert effects_table([]).empty


def test_what_is_not_stated_is_shown_as_a_dash_and_a_remark_behind_its_quantity():
    effects = [
        Effect("denser_traffic", 1.2, "density", "veh/km", 240.0, 210.0, 200.0, "the road is full"),
        Effect("denser_traffic", 1.2, "flow", "veh/h", np.nan, 8583.2, 8919.0),
    ]
    assert shown_effects(effects_table(effects)).lines == [
        ["denser_traffic 1.2", "density [veh/km] (the road is full)", "240", "210", "200"],
        ["", "flow [veh/h]", "-", "8583", "8919"],
    ]


def test_a_column_without_any_number_is_shown_as_dashes():
    """As read from a file: the effect of a braking leader has no value without the perturbation."""
    table = effects_table([Effect("leader_braking", 3.0, "braking", "m/s²", 3.0, 3.0)])
    assert (
        shown_effects(table).lines == shown_effects(table.astype({"unperturbed": object}).replace({np.nan: None})).lines
    )
    assert shown_effects(table).lines == [["leader_braking 3", "braking [m/s²]", "3.00", "3.00", "-"]]


@pytest.mark.parametrize("steps", [0, 1, 5])
def test_the_delay_is_found_where_values_move_and_is_none_where_they_stand(steps):
    moving = np.cumsum(np.random.default_rng(1).random((40, 3)), axis=0)
    assert delay_between(moving[5:], moving[5 - steps : 40 - steps]) == steps
    assert delay_between(np.ones((40, 3)), np.ones((40, 3))) == 0
