"""Hand-made situations: three vehicles 10, 11, 12 in one scene, 0.2 s steps."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.measures.label_agreement import agreement
from cosim.measures.relation_labels import (
    CUT_IN,
    FOLLOW,
    NO_VEHICLE,
    NONE,
    REACTION_THRESHOLD,
    YIELD,
    DriverRecords,
    PairLabels,
    Reduction,
    pair_labels,
    reactions_by_intervention,
    reactions_by_rule,
    reduce_labels,
)
from gri.core.graph import pairs

T = 20
VEHICLES = np.array([[10, 11, 12]])


def no_interaction() -> DriverRecords:
    """Three vehicles at 10 m/s without leaders; all accelerate to 10.4 m/s, their free speed."""
    values, no_vehicle = np.full((1, 3, T), 10.0), np.full((1, 3, T), NO_VEHICLE)
    return DriverRecords(
        vehicle=VEHICLES,
        v=values,
        v_next=values + 0.4,
        free_speed=values + 0.4,
        speed_behind_leader=np.full((1, 3, T), np.inf),
        speed_behind_target=np.full((1, 3, T), np.inf),
        imperfection=np.full((1, 3, T), 0.6),
        leader=no_vehicle,
        requester=no_vehicle,
        target=no_vehicle,
        cooperative_change=np.zeros((1, 3, T), bool),
        new_follower=no_vehicle,
        new_follower_margin=np.full((1, 3, T), np.inf),
        dt=0.2,
    )


def at(values: np.ndarray, vehicle: int, steps: slice | int, value: float) -> np.ndarray:
    changed = values.copy()
    changed[0, vehicle, steps] = value
    return changed


def rule(records: DriverRecords) -> dict[tuple[int, int], np.ndarray]:
    return dict(zip(pairs(3), pair_labels(reactions_by_rule(records), VEHICLES).types[0], strict=True))


def gold(
    records: DriverRecords, effect_of_leader: np.ndarray, effect_of_requests: np.ndarray
) -> dict[tuple[int, int], np.ndarray]:
    return dict(
        zip(
            pairs(3),
            pair_labels(reactions_by_intervention(records, effect_of_leader, effect_of_requests), VEHICLES).types[0],
            strict=True,
        )
    )


def bound(records: DriverRecords, vehicle: int, leader: int, steps: slice = slice(None)) -> DriverRecords:
    """The car-following model of the vehicle allows 10 m/s behind the leader, and it drives 10 m/s."""
    return replace(
        records,
        leader=at(records.leader, vehicle, steps, leader),
        speed_behind_leader=at(records.speed_behind_leader, vehicle, steps, 10.0),
        v_next=at(records.v_next, vehicle, steps, 10.0),
    )


def test_vehicles_on_an_empty_road_do_not_react():
    assert all((types == NONE).all() for types in rule(no_interaction()).values())


def test_a_leader_that_does_not_bind_is_not_followed():
    records = no_interaction()
    far = replace(
        records,
        leader=at(records.leader, 0, slice(None), 11),
        speed_behind_leader=at(records.speed_behind_leader, 0, slice(None), 12.0),
    )
    assert (rule(far)[1, 0] == NONE).all()


def test_a_vehicle_slowed_by_its_leader_follows_it():
    records = bound(no_interaction(), 0, 11)
    labels = pair_labels(reactions_by_rule(records), VEHICLES)
    assert (rule(records)[1, 0] == FOLLOW).all()
    assert (rule(records)[0, 1] == NONE).all()
    assert labels.effect[0, pairs(3).index((1, 0)), 0] == pytest.approx(-2.0)  # (10 - 10.4) / 0.2


def test_the_label_may_change_from_step_to_step():
    types = rule(bound(no_interaction(), 0, 11, slice(5, 8)))[1, 0]
    assert types.tolist() == [NONE] * 5 + [FOLLOW] * 3 + [NONE] * 12


def test_random_imperfection_is_neither_yielding_nor_an_end_of_following():
    records = bound(no_interaction(), 0, 11)
    records = replace(
        records, v_next=records.v_next - 0.12, requester=at(records.requester, 0, slice(None), 12)
    )  # 0.6 m/s² of noise
    assert (rule(records)[1, 0] == FOLLOW).all()
    assert (rule(records)[2, 0] == NONE).all()


def test_a_vehicle_that_slows_after_a_request_yields():
    records = no_interaction()
    asked = replace(
        records, requester=at(records.requester, 1, slice(3, 9), 10), v_next=at(records.v_next, 1, slice(5, 7), 9.6)
    )
    assert rule(asked)[0, 1].tolist() == [NONE] * 5 + [YIELD] * 2 + [NONE] * 13


def test_a_vehicle_that_adapts_to_its_target_follows_it():
    records = no_interaction()
    braking = replace(
        records, v_next=at(records.v_next, 0, slice(4, 9), 9.6), target=at(records.target, 0, slice(None), 12)
    )
    fitting = replace(braking, speed_behind_target=at(records.speed_behind_target, 0, slice(None), 9.0))
    expected = [NONE] * 4 + [FOLLOW] * 5 + [NONE] * 11
    assert rule(fitting)[2, 0].tolist() == expected
    assert gold(fitting, records.v * 0, records.v * 0)[2, 0].tolist() == expected
    labels = pair_labels(reactions_by_rule(fitting), VEHICLES)
    assert labels.effect[0, pairs(3).index((2, 0)), 5] == pytest.approx((9.6 - 10.4) / 0.2 + 0.6)
    # harder than the target asks for, as for the end of the lane
    assert (rule(braking)[2, 0] == NONE).all()
    assert (
        rule(replace(fitting, speed_behind_target=at(records.speed_behind_target, 0, slice(None), 9.9)))[2, 0] == NONE
    ).all()


@pytest.mark.parametrize(("target_speed", "types"), [(9.6, FOLLOW), (9.724, FOLLOW), (9.736, NONE)])
def test_a_vehicle_may_be_slower_than_its_target_asks_for_by_imperfection_and_tolerance(
    target_speed: float, types: int
):
    """0.6 m/s² of imperfection and 0.05 of tolerance are 0.13 m/s in 0.2 s: 9.6 is explained up to 9.73."""
    records = no_interaction()
    adapting = replace(
        records,
        v_next=at(records.v_next, 0, slice(None), 9.6),
        target=at(records.target, 0, slice(None), 12),
        speed_behind_target=at(records.speed_behind_target, 0, slice(None), target_speed),
    )
    assert (rule(adapting)[2, 0] == types).all()


@pytest.mark.parametrize(
    ("v", "behind_leader", "v_next", "types", "effect"),
    [
        (10.0, 0.0, 8.2, FOLLOW, -11.0),  # brakes as hard as a vehicle can, by 1.8 m/s
        (10.0, 0.0, 7.5, NONE, 0.0),  # harder: not for its leader alone
        (1.0, 0.0, 0.0, FOLLOW, -7.0),  # nobody reverses
        (1.0, 0.5, 0.5, FOLLOW, -4.5),
    ],
)
def test_a_leader_explains_no_more_than_the_hardest_braking(v, behind_leader, v_next, types, effect):
    """All would drive v + 0.4 m/s after 0.2 s without a leader."""
    records = no_interaction()
    braking = replace(
        records,
        v=at(records.v, 0, slice(None), v),
        free_speed=at(records.free_speed, 0, slice(None), v + 0.4),
        leader=at(records.leader, 0, slice(None), 11),
        speed_behind_leader=at(records.speed_behind_leader, 0, slice(None), behind_leader),
        v_next=at(records.v_next, 0, slice(None), v_next),
    )
    labels, pair = pair_labels(reactions_by_rule(braking), VEHICLES), pairs(3).index((1, 0))
    assert (labels.types[0, pair] == types).all()
    np.testing.assert_allclose(labels.effect[0, pair], effect)


def test_what_imperfection_and_tolerance_explain_to_the_last_bit_is_explained():
    """0.05 m/s² less than the model allows, without imperfection: as much as the tolerance."""
    still = replace(no_interaction(), v=np.zeros((1, 3, T)), v_next=np.zeros((1, 3, T)), dt=1.0)
    still = replace(still, imperfection=np.zeros((1, 3, T)), free_speed=np.full((1, 3, T), 1.0))
    following = replace(
        still,
        leader=at(still.leader, 0, slice(None), 11),
        speed_behind_leader=at(still.speed_behind_leader, 0, slice(None), 0.05),
    )
    assert (rule(following)[1, 0] == FOLLOW).all()
    asked = replace(following, requester=at(still.requester, 0, slice(None), 12))
    assert (rule(asked)[2, 0] == NONE).all()
    free = replace(still, free_speed=np.full((1, 3, T), 0.05), target=at(still.target, 0, slice(None), 12))
    free = replace(free, speed_behind_target=np.zeros((1, 3, T)))
    assert (rule(free)[2, 0] == NONE).all()


def test_who_does_not_react_owes_no_acceleration():
    records = bound(no_interaction(), 0, 11, slice(5, 8))
    asked = replace(records, requester=at(records.requester, 1, 4, 10))
    asked = replace(asked, v_next=at(asked.v_next, 1, 4, 9.6))
    still = np.zeros((1, 3, T))
    by_intervention = reactions_by_intervention(records, at(still, 0, slice(5, 8), -2.0), still)
    for reactions in (reactions_by_rule(asked), by_intervention):
        for reaction in (reactions.follow, reactions.yielding, reactions.cut_in):
            assert not reaction.effect[reaction.to == NO_VEHICLE].any()
    assert reactions_by_rule(asked).yielding.effect[0, 1, 4] == pytest.approx((9.6 - 10.4) / 0.2 + 0.6)
    assert by_intervention.follow.effect[0, 0, 5:8].tolist() == [-2.0] * 3


def test_durations_are_counted_in_steps_of_the_scenes():
    records = replace(no_interaction(), stride=5)  # 1 s per step of the scenes
    assert [records.steps(x) for x in (2.0, 1.4, 0.1)] == [2, 1, 1]


def test_a_vehicle_slowed_by_its_leader_does_not_follow_its_target():
    records = bound(no_interaction(), 0, 11)
    both = replace(
        records,
        target=at(records.target, 0, slice(None), 12),
        speed_behind_target=at(records.speed_behind_target, 0, slice(None), 9.8),
    )
    assert (rule(both)[1, 0] == FOLLOW).all()
    assert (rule(both)[2, 0] == NONE).all()


def test_slowing_for_its_own_lane_change_without_a_target_is_no_reaction():
    records = bound(no_interaction(), 0, 11)
    slower = replace(records, v_next=at(records.v_next, 0, slice(None), 9.5))
    assert all((types == NONE).all() for types in rule(slower).values())


def test_a_cooperative_lane_change_is_yielding_for_a_second():
    records = no_interaction()
    helped = replace(
        records,
        requester=at(records.requester, 1, 4, 10),
        cooperative_change=records.cooperative_change | (at(records.v, 1, 4, -1) < 0),
    )
    expected = [NONE] * 4 + [YIELD] * 5 + [NONE] * 11
    assert rule(helped)[0, 1].tolist() == expected
    assert gold(helped, records.v * 0, records.v * 0)[0, 1].tolist() == expected
    for reactions in (reactions_by_rule(helped), reactions_by_intervention(helped, records.v * 0, records.v * 0)):
        assert not pair_labels(reactions, VEHICLES).effect.any(), "it costs no acceleration"


def test_yielding_now_goes_before_having_made_room():
    records = no_interaction()
    helped = replace(
        records,
        requester=at(at(records.requester, 1, 4, 10), 1, 6, 12),
        cooperative_change=records.cooperative_change | (at(records.v, 1, 4, -1) < 0),
        v_next=at(records.v_next, 1, 6, 9.6),
    )
    assert rule(helped)[2, 1].tolist() == [NONE] * 6 + [YIELD] + [NONE] * 13
    assert rule(helped)[0, 1].tolist() == [NONE] * 4 + [YIELD] * 2 + [NONE] + [YIELD] * 2 + [NONE] * 11


@pytest.mark.parametrize(("margin", "types"), [(1.0, CUT_IN), (2.0, NONE), (3.0, NONE)])
def test_a_lane_change_into_less_than_the_secure_gap_is_a_cut_in(margin: float, types: int):
    records = no_interaction()
    changed = replace(
        records,
        new_follower=at(records.new_follower, 0, 6, 11),
        new_follower_margin=at(records.new_follower_margin, 0, 6, margin),
    )
    assert rule(changed)[1, 0].tolist() == [NONE] * 6 + [types] * 5 + [NONE] * 9
    assert not pair_labels(reactions_by_rule(changed), VEHICLES).effect.any(), "nobody follows 10"


def test_a_cut_in_slows_the_new_follower_within_two_seconds():
    records = no_interaction()
    changed = replace(
        records, new_follower=at(records.new_follower, 0, 6, 11), leader=at(records.leader, 1, slice(6, T), 10)
    )
    still = np.zeros((1, 3, T))
    early, late, weak = at(still, 1, 12, -0.8), at(still, 1, 17, -0.8), at(still, 1, 12, -0.4)
    assert gold(changed, early, still)[1, 0].tolist() == [NONE] * 6 + [CUT_IN] * 5 + [NONE] * 9
    assert gold(changed, early, still)[0, 1][12] == FOLLOW
    effect = pair_labels(reactions_by_intervention(changed, early, still), VEHICLES).effect[0, pairs(3).index((1, 0))]
    assert effect.tolist() == [0.0] * 6 + [-0.8] * 5 + [0.0] * 9
    assert (gold(changed, late, still)[1, 0] == NONE).all()
    assert (gold(changed, weak, still)[1, 0] == NONE).all()


def test_a_cut_in_near_the_end_of_the_scene_counts():
    records = no_interaction()
    changed = replace(
        records, new_follower=at(records.new_follower, 0, 15, 11), leader=at(records.leader, 1, slice(15, T), 10)
    )
    still = np.zeros((1, 3, T))
    assert gold(changed, at(still, 1, 16, -0.8), still)[1, 0].tolist() == [NONE] * 15 + [CUT_IN] * 5


def test_an_effect_of_the_threshold_itself_is_no_reaction():
    records = no_interaction()
    records = replace(
        records,
        leader=at(records.leader, 1, slice(None), 12),
        requester=at(records.requester, 1, slice(None), 10),
        new_follower=at(records.new_follower, 2, 3, 1),
    )
    threshold = np.full((1, 3, T), REACTION_THRESHOLD)
    assert all((types == NONE).all() for types in gold(records, threshold, threshold).values())


def test_interventions_tell_following_from_yielding():
    records = replace(
        no_interaction(),
        leader=at(no_interaction().leader, 1, slice(None), 12),
        requester=at(no_interaction().requester, 1, slice(None), 10),
    )
    still = np.zeros((1, 3, T))
    labels = gold(records, at(still, 1, slice(None), -1.0), at(still, 1, slice(8, T), -2.0))
    assert (labels[2, 1] == FOLLOW).all()
    assert labels[0, 1].tolist() == [NONE] * 8 + [YIELD] * 12
    assert (gold(records, at(still, 1, slice(None), -0.05), still)[2, 1] == NONE).all()


def test_a_cut_in_hides_yielding_and_yielding_hides_following_of_the_same_pair():
    records = bound(no_interaction(), 0, 11)
    records = replace(
        records,
        requester=records.leader,
        v_next=at(records.v_next, 0, slice(4, 6), 9.0),
        new_follower=at(records.new_follower, 0, 5, 11),
    )
    records = replace(records, new_follower_margin=at(records.new_follower_margin, 0, 5, 0.0))
    assert rule(records)[1, 0].tolist() == [FOLLOW] * 4 + [YIELD] + [CUT_IN] * 5 + [FOLLOW] * 10


def steps_of(*types: int, effects: tuple[float, ...] | None = None) -> PairLabels:
    values = np.zeros((1, 1, len(types))) if effects is None else np.array([[effects]])
    return PairLabels(np.array([[types]]), values)


def test_reductions_of_hand_made_steps():
    short = steps_of(NONE, NONE, FOLLOW, FOLLOW, YIELD, NONE, NONE, effects=(0, 0, -1.0, -1.5, -4.0, 0, 0))
    assert reduce_labels(short, Reduction.STRONGEST, 2)[0].item() == YIELD
    assert reduce_labels(short, Reduction.LONGEST, 2)[0].item() == NONE
    assert not reduce_labels(short, Reduction.STRONGEST, 2)[1].item()
    moved_over = steps_of(NONE, YIELD, YIELD, FOLLOW)
    assert reduce_labels(moved_over, Reduction.STRONGEST, 2)[0].item() == YIELD  # no effects: the longer one


@pytest.mark.parametrize(
    ("types", "effects", "strongest"),
    [
        ((NONE,) * 4, (0.0,) * 4, NONE),
        ((YIELD, FOLLOW, FOLLOW, FOLLOW), (-0.8, -0.5, -0.5, -0.5), YIELD),
        ((YIELD, FOLLOW, FOLLOW, FOLLOW), (-1.5, -1.0, -1.0, -1.0), YIELD),
        ((YIELD, FOLLOW, FOLLOW, FOLLOW), (-0.5, -0.5, -0.25, -0.25), FOLLOW),
        ((NONE, NONE, NONE, NONE, YIELD, YIELD), (0.0,) * 6, YIELD),
        ((CUT_IN, YIELD, NONE, NONE), (-0.25, 0.0, 0.0, 0.0), CUT_IN),
    ],
)
def test_the_strongest_interaction_is_the_type_however_short(types, effects, strongest):
    assert reduce_labels(steps_of(*types, effects=effects), Reduction.STRONGEST, 2)[0].item() == strongest


def test_a_reduction_is_unambiguous_with_one_lasting_interaction_or_none_at_all():
    for types, clear in (((NONE,) * 4, True), ((NONE, FOLLOW, FOLLOW, NONE), True), ((FOLLOW, *(NONE,) * 3), False)):
        for how in Reduction:
            assert reduce_labels(steps_of(*types), how, 2)[1].item() == clear


def test_kappa_precision_and_recall_by_hand():
    found = agreement(np.array([0] * 25 + [1] * 25), np.array([0] * 20 + [1] * 15 + [0] * 10 + [1] * 5), 2)
    assert found.counts.tolist() == [[20, 5], [10, 15]]
    assert found.kappa == pytest.approx(0.4)  # agreed 0.7, by chance 0.5
    assert found.precision(1) == pytest.approx(0.6)
    assert found.recall(1) == pytest.approx(0.75)
    assert np.isnan(agreement(np.array([0]), np.array([0]), 2).recall(1))
    assert agreement(np.array([0]), np.array([0]), 2).kappa == 1.0
    assert (found + found).total == 100
