"""Delays of changes, false switches and macro-F1: worked out by hand on short sequences."""

import numpy as np
import pytest
import torch

from cosim.loop.graph_source import smoothed
from cosim.measures.graph_changes import graph_changes, macro_f1, smoothed_over_time
from cosim.spec.scenario import Inferred
from gri.core.graph import LANE_CHANGING, InteractionGraph

DT = 0.5  # a change counts if both sides hold for two steps


def types(*rows: str) -> np.ndarray:
    """Rows of digits as types; 0 is none."""
    return np.array([[int(kind) for kind in row] for row in rows])


def test_delays_are_counted_from_the_true_change():
    truth = types("0000111100000", "0000222222222", "1111111100000")
    found = types("0000000111100", "0000000000000", "1111111111100")
    changes = graph_changes(truth, found, 0, DT)
    assert changes.new.tolist() == [1.5, np.inf], "the second relation is never noticed"
    assert changes.ended.tolist() == [1.5, 1.5]
    assert changes.anticipated == 0


def test_what_was_there_before_is_no_delay_and_what_is_short_is_no_change():
    truth, found = types("000011110000", "000010000000"), types("111111111111", "000000000000")
    changes = graph_changes(truth, found, 0, DT)
    assert (len(changes.new), changes.anticipated) == (0, 1)
    assert changes.ended.tolist() == [np.inf]


def test_false_switches_are_changes_to_what_is_not_true_nearby():
    truth = types("0000000000", "0000011111")
    assert graph_changes(truth, truth, 0, DT).false_switches == 0.0
    found = types("0001100000", "0000111111")
    changes = graph_changes(truth, found, 0, DT)
    assert changes.false_switches == pytest.approx(1 / (2 * 10 * DT)), "to 1 in the first row; back to 0 is right"


def test_macro_f1_counts_rare_types_as_much_as_common_ones():
    truth, constant = types("0000000011"), types("0000000000")
    assert macro_f1(truth, truth) == 1.0
    assert macro_f1(truth, constant) == pytest.approx((2 * 8 / 18 + 0.0) / 2)


def test_smoothing_over_time_is_that_of_the_closed_loop():
    generator = torch.Generator().manual_seed(1)
    logits = torch.randn(5, 7, 6, 4, generator=generator, dtype=torch.float64)  # inferences, scenes, pairs, types
    graph = InteractionGraph(logits[0], LANE_CHANGING)
    wanted = [graph.probs]
    for now in logits[1:]:
        graph = smoothed(InteractionGraph(now, LANE_CHANGING), graph, Inferred(switching_rate=0.1), 1.0, 5.0)
        wanted.append(graph.probs)
    probs = logits.softmax(-1).flatten(1, 2).transpose(0, 1).numpy()
    found = smoothed_over_time(probs, 1.0, 5.0, 0.1)
    np.testing.assert_allclose(found, torch.stack(wanted).flatten(1, 2).transpose(0, 1).numpy(), atol=1e-6)
