"""Graphs beside the simulator's truth, by hand."""

import pytest
import torch

from gri.graph import FOLLOWING
from gri.truth import beside_truth, truth_tables


def test_accuracies_and_confusion_by_hand():
    true = torch.tensor([[0, 0, 1, 0, 0, 1], [0, 0, 1, 0, 0, 0]])
    inferred = torch.tensor([[0, 0, 1, 0, 0, 1], [0, 0, 1, 1, 0, 1]])
    hypothesis = torch.tensor([[0, 0, 1, 0, 0, 1]] * 2)
    found = beside_truth(inferred, true, hypothesis, torch.tensor([True, False]))
    means = {name: value.mean for name, value in found.accuracy.items()}
    assert means["inferred, truth"] == pytest.approx(5 / 6)
    assert means["inferred, hypothesis"] == pytest.approx(11 / 12)
    assert means["hypothesis, truth"] == pytest.approx(11 / 12)
    assert means["inferred, truth, 1 unambiguous scenes"] == 1
    assert found.confusion.tolist() == [[7, 2], [0, 3]]
    assert [table.row_count for table in truth_tables(found, FOLLOWING)] == [6, 2]


def test_without_unambiguous_scenes_only_all_are_compared():
    types = torch.zeros(2, 6, dtype=torch.int64)
    assert len(beside_truth(types, types, types, torch.tensor([False, False])).accuracy) == 3
