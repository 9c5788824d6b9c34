"""Hand-made situations: three vehicles 10, 11, 12 in one scene, 0.2 s steps."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.measures.label_agreement import agreement
from cosim.measures.relation_labels import (
    CUT_IN,
    FOLLOW,
    NOBODY,
    NONE,
    YIELD,
    DriverRecords,
    PairLabels,
    Reduction,
    by_intervention,
    by_rule,
    pair_labels,
    reduced,
)
from gri.core.graph import pairs

T = 20
VEHICLES = np.array([[10, 11, 12]])


def nothing() -> DriverRecords:
    """10 m/s, everybody free to reach 10.4 m/s and doing so."""
    values, nobody = np.full((1, 3, T), 10.0), np.full((1, 3, T), NOBODY)
    return DriverRecords(
        vehicle=VEHICLES,
        v=values,
        v_next=values + 0.4,
        free=values + 0.4,
        behind=np.full((1, 3, T), np.inf),
        beside=np.full((1, 3, T), np.inf),
        noise=np.full((1, 3, T), 0.6),
        leader=nobody,
        asker=nobody,
        target=nobody,
        gave_way=np.zeros((1, 3, T), bool),
        cut=nobody,
        room=np.full((1, 3, T), np.inf),
        dt=0.2,
    )


def at(values: np.ndarray, vehicle: int, steps: slice | int, value: float) -> np.ndarray:
    changed = values.copy()
    changed[0, vehicle, steps] = value
    return changed


def rule(told: DriverRecords) -> dict[tuple[int, int], np.ndarray]:
    return dict(zip(pairs(3), pair_labels(by_rule(told), VEHICLES).types[0], strict=True))


def gold(told: DriverRecords, unled: np.ndarray, unasked: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
    return dict(zip(pairs(3), pair_labels(by_intervention(told, unled, unasked), VEHICLES).types[0], strict=True))


def bound(told: DriverRecords, vehicle: int, leader: int, steps: slice = slice(None)) -> DriverRecords:
    """The vehicle's model allows 10 m/s behind the leader, and it drives so."""
    return replace(
        told,
        leader=at(told.leader, vehicle, steps, leader),
        behind=at(told.behind, vehicle, steps, 10.0),
        v_next=at(told.v_next, vehicle, steps, 10.0),
    )


def test_nobody_reacts_on_an_empty_road():
    assert all((types == NONE).all() for types in rule(nothing()).values())


def test_a_leader_that_does_not_bind_is_not_followed():
    told = nothing()
    far = replace(told, leader=at(told.leader, 0, slice(None), 11), behind=at(told.behind, 0, slice(None), 12.0))
    assert (rule(far)[1, 0] == NONE).all()


def test_who_is_held_by_its_leader_follows_it():
    told = bound(nothing(), 0, 11)
    labels = pair_labels(by_rule(told), VEHICLES)
    assert (rule(told)[1, 0] == FOLLOW).all()
    assert (rule(told)[0, 1] == NONE).all()
    assert labels.effect[0, pairs(3).index((1, 0)), 0] == pytest.approx(-2.0)  # (10 - 10.4) / 0.2


def test_the_label_may_change_from_step_to_step():
    types = rule(bound(nothing(), 0, 11, slice(5, 8)))[1, 0]
    assert types.tolist() == [NONE] * 5 + [FOLLOW] * 3 + [NONE] * 12


def test_random_slowness_is_no_yield_and_breaks_no_following():
    told = bound(nothing(), 0, 11)
    told = replace(told, v_next=told.v_next - 0.12, asker=at(told.asker, 0, slice(None), 12))  # 0.6 m/s² of noise
    assert (rule(told)[1, 0] == FOLLOW).all()
    assert (rule(told)[2, 0] == NONE).all()


def test_who_slows_for_somebody_that_asks_yields():
    told = nothing()
    asked = replace(told, asker=at(told.asker, 1, slice(3, 9), 10), v_next=at(told.v_next, 1, slice(5, 7), 9.6))
    assert rule(asked)[0, 1].tolist() == [NONE] * 5 + [YIELD] * 2 + [NONE] * 13


def test_who_slows_to_fit_in_behind_its_target_follows_it():
    told = nothing()
    braking = replace(told, v_next=at(told.v_next, 0, slice(4, 9), 9.6), target=at(told.target, 0, slice(None), 12))
    fitting = replace(braking, beside=at(told.beside, 0, slice(None), 9.0))
    expected = [NONE] * 4 + [FOLLOW] * 5 + [NONE] * 11
    assert rule(fitting)[2, 0].tolist() == expected
    assert gold(fitting, told.v * 0, told.v * 0)[2, 0].tolist() == expected
    labels = pair_labels(by_rule(fitting), VEHICLES)
    assert labels.effect[0, pairs(3).index((2, 0)), 5] == pytest.approx((9.6 - 10.4) / 0.2 + 0.6)
    # harder than the target asks for, as for the end of the lane
    assert (rule(braking)[2, 0] == NONE).all()
    assert (rule(replace(fitting, beside=at(told.beside, 0, slice(None), 9.9)))[2, 0] == NONE).all()


def test_who_is_held_by_its_own_leader_follows_that_one_and_not_its_target():
    told = bound(nothing(), 0, 11)
    both = replace(told, target=at(told.target, 0, slice(None), 12), beside=at(told.beside, 0, slice(None), 9.8))
    assert (rule(both)[1, 0] == FOLLOW).all()
    assert (rule(both)[2, 0] == NONE).all()


def test_who_slows_for_its_own_lane_change_with_nobody_there_neither_yields_nor_follows():
    told = bound(nothing(), 0, 11)
    slower = replace(told, v_next=at(told.v_next, 0, slice(None), 9.5))
    assert all((types == NONE).all() for types in rule(slower).values())


def test_moving_over_for_somebody_is_yielding_for_a_second():
    told = nothing()
    helped = replace(told, asker=at(told.asker, 1, 4, 10), gave_way=told.gave_way | (at(told.v, 1, 4, -1) < 0))
    expected = [NONE] * 4 + [YIELD] * 5 + [NONE] * 11
    assert rule(helped)[0, 1].tolist() == expected
    assert gold(helped, told.v * 0, told.v * 0)[0, 1].tolist() == expected


@pytest.mark.parametrize(("room", "types"), [(1.0, CUT_IN), (3.0, NONE)])
def test_a_lane_change_into_less_than_the_secure_gap_is_a_cut_in(room: float, types: int):
    told = nothing()
    changed = replace(told, cut=at(told.cut, 0, 6, 11), room=at(told.room, 0, 6, room))
    assert rule(changed)[1, 0].tolist() == [NONE] * 6 + [types] * 5 + [NONE] * 9


def test_a_cut_in_is_what_the_vehicle_behind_feels_within_two_seconds():
    told = nothing()
    changed = replace(told, cut=at(told.cut, 0, 6, 11), leader=at(told.leader, 1, slice(6, T), 10))
    still = np.zeros((1, 3, T))
    early, late, weak = at(still, 1, 12, -0.8), at(still, 1, 17, -0.8), at(still, 1, 12, -0.4)
    assert gold(changed, early, still)[1, 0].tolist() == [NONE] * 6 + [CUT_IN] * 5 + [NONE] * 9
    assert gold(changed, early, still)[0, 1][12] == FOLLOW
    assert (gold(changed, late, still)[1, 0] == NONE).all()
    assert (gold(changed, weak, still)[1, 0] == NONE).all()


def test_interventions_tell_following_from_yielding():
    told = replace(
        nothing(), leader=at(nothing().leader, 1, slice(None), 12), asker=at(nothing().asker, 1, slice(None), 10)
    )
    still = np.zeros((1, 3, T))
    labels = gold(told, at(still, 1, slice(None), -1.0), at(still, 1, slice(8, T), -2.0))
    assert (labels[2, 1] == FOLLOW).all()
    assert labels[0, 1].tolist() == [NONE] * 8 + [YIELD] * 12
    assert (gold(told, at(still, 1, slice(None), -0.05), still)[2, 1] == NONE).all()


def test_a_cut_in_hides_yielding_and_yielding_hides_following_of_the_same_pair():
    told = bound(nothing(), 0, 11)
    told = replace(told, asker=told.leader, v_next=at(told.v_next, 0, slice(4, 6), 9.0), cut=at(told.cut, 0, 5, 11))
    told = replace(told, room=at(told.room, 0, 5, 0.0))
    assert rule(told)[1, 0].tolist() == [FOLLOW] * 4 + [YIELD] + [CUT_IN] * 5 + [FOLLOW] * 10


def steps_of(*types: int, effects: tuple[float, ...] | None = None) -> PairLabels:
    values = np.zeros((1, 1, len(types))) if effects is None else np.array([[effects]])
    return PairLabels(np.array([[types]]), values)


def test_reductions_of_hand_made_steps():
    short = steps_of(NONE, NONE, FOLLOW, FOLLOW, YIELD, NONE, NONE, effects=(0, 0, -1.0, -1.5, -4.0, 0, 0))
    assert reduced(short, Reduction.STRONGEST, 2)[0].item() == YIELD
    assert reduced(short, Reduction.LONGEST, 2)[0].item() == NONE
    assert not reduced(short, Reduction.STRONGEST, 2)[1].item()
    moved_over = steps_of(NONE, YIELD, YIELD, FOLLOW)
    assert reduced(moved_over, Reduction.STRONGEST, 2)[0].item() == YIELD  # no effects: the longer one


def test_a_reduction_is_unambiguous_with_one_lasting_interaction_or_none_at_all():
    for types, clear in (((NONE,) * 4, True), ((NONE, FOLLOW, FOLLOW, NONE), True), ((FOLLOW, *(NONE,) * 3), False)):
        for how in Reduction:
            assert reduced(steps_of(*types), how, 2)[1].item() == clear


def test_kappa_precision_and_recall_by_hand():
    found = agreement(np.array([0] * 25 + [1] * 25), np.array([0] * 20 + [1] * 15 + [0] * 10 + [1] * 5), 2)
    assert found.counts.tolist() == [[20, 5], [10, 15]]
    assert found.kappa == pytest.approx(0.4)  # agreed 0.7, by chance 0.5
    assert found.precision(1) == pytest.approx(0.6)
    assert found.recall(1) == pytest.approx(0.75)
    assert np.isnan(agreement(np.array([0]), np.array([0]), 2).recall(1))
    assert agreement(np.array([0]), np.array([0]), 2).kappa == 1.0
    assert (found + found).total == 100
