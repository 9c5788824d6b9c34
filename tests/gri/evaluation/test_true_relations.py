"""Graphs beside the simulator's truth, by hand."""

from pathlib import Path

import numpy as np
import pytest
import torch

from gri.commands.cli import app
from gri.core.edges import EdgeType
from gri.core.graph import FOLLOWING
from gri.data.scene_file.schema import Header, SceneBlock, names_of, writing
from gri.evaluation.true_relations import compare_with_truth, truth_tables


def test_accuracies_and_confusion_by_hand():
    true = torch.tensor([[0, 0, 1, 0, 0, 1], [0, 0, 1, 0, 0, 0]])
    inferred = torch.tensor([[0, 0, 1, 0, 0, 1], [0, 0, 1, 1, 0, 1]])
    hypothesis = torch.tensor([[0, 0, 1, 0, 0, 1]] * 2)
    found = compare_with_truth(inferred, true, hypothesis, torch.tensor([True, False]))
    means = {name: value.mean for name, value in found.accuracy.items()}
    assert means["inferred, truth"] == pytest.approx(5 / 6)
    assert means["inferred, hypothesis"] == pytest.approx(11 / 12)
    assert means["hypothesis, truth"] == pytest.approx(11 / 12)
    assert means["inferred, truth, 1 unambiguous scenes"] == 1
    assert means["most frequent, truth"] == pytest.approx(11 / 12)
    assert found.confusion[""].tolist() == [[7, 2], [0, 3]]
    assert found.confusion[", 1 unambiguous scenes"].tolist() == [[4, 0], [0, 2]]
    assert [len(table.lines) for table in truth_tables(found, FOLLOWING)] == [8, 2, 2]


def test_without_unambiguous_scenes_only_all_are_compared():
    types = torch.zeros(2, 6, dtype=torch.int64)
    assert len(compare_with_truth(types, types, types, torch.tensor([False, False])).accuracy) == 4


def test_a_released_model_is_scored_on_scenes_of_sumo(tmp_path: Path, capsys, monkeypatch):
    """Three vehicles 15 m apart at 10 m/s."""
    x = np.array([0.0, 15.0, 30.0])[None, :, None] + 2.0 * np.arange(30)
    chain = names_of({(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW})[None]
    scene = SceneBlock(
        kind="car_following",
        source=np.array(["us101_merge"], object),
        recording=np.array(["seed 1"], object),
        split=np.array(["test"], object),
        start=np.zeros(1),
        vehicle=np.array([[1, 2, 3]]),
        features={"x": x, "v": np.full_like(x, 10.0), "a": np.zeros_like(x)},
        edges=chain,
        size={"length": np.full((1, 3), 5.0)},
        hypothesis=chain,
        unambiguous=np.array([True]),
    )
    with writing(tmp_path / "scenes.parquet", Header(dt=0.2)) as write:
        write(scene)
    monkeypatch.setenv("COLUMNS", "120")
    app(["evaluate", "us101_car_following", "--scene-file", str(tmp_path / "scenes.parquet")], standalone_mode=False)
    told = capsys.readouterr().out
    assert "Beside the simulator's truth" in told
    assert "inferred, truth, 1 unambiguous scenes" in told
    assert "Edges by type" in told
