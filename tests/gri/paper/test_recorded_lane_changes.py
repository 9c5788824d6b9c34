from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gri.core.scenes import Scenes
from gri.core.trajectory import Trajectory
from gri.data.ranges.recorded import NGSIM_LANE_CHANGING
from gri.data.scene_file.reading import Recorded
from gri.paper import recorded_lane_changes, run_jobs
from gri.paper.job_cache import SceneFile
from gri.paper.plan import Plan, jobs_of
from gri.paper.publish import publish
from gri.paper.recorded_lane_changes import blurred, clusters_and_folds, hypotheses, lane_changes_of


def windows(*vehicles: tuple[int, int, int], site: str = "us-101") -> Recorded:
    """A `Recorded` of which only the numbers of the vehicles matter."""
    count = len(vehicles)
    state = torch.zeros(count, 3, 2, 6)
    words = np.full(count, site, object)
    return Recorded(
        Trajectory.complete(state, 0.2), torch.zeros(count, 6, dtype=torch.int64), words, words,
        np.array(vehicles), torch.zeros(count, 3),
    )  # fmt: skip


def test_windows_that_share_a_vehicle_are_in_one_fold():
    found = windows((1, 2, 3), (4, 5, 6), (3, 7, 8), (8, 9, 10), (11, 12, 13))
    cluster, fold = clusters_and_folds(found, folds=2)
    assert cluster[0] == cluster[2] == cluster[3]
    assert len(set(cluster.tolist())) == 3
    assert fold.tolist() == [0, 1, 0, 0, 1]  # the cluster of three, then the two others in the other fold


def test_no_vehicle_of_a_recorded_lane_change_is_in_a_drawn_one(lane_file: Path):
    found = lane_changes_of(lane_file, NGSIM_LANE_CHANGING)
    assert len(found.recorded) == len(found.found) == 4  # two lane changes under two hypotheses
    assert {int(v) for v in found.found.vehicle.ravel()} <= {1, 2, 3, 4, 101, 102, 103, 104}
    assert len(found.drawn) > 0
    assert len(found.validation) > 0
    assert hypotheses(found.recorded, NGSIM_LANE_CHANGING).tolist() == [0, 0, 1, 1]


def test_only_lateral_speeds_and_accelerations_of_the_first_step_are_blurred(lane_file: Path):
    drawn = lane_changes_of(lane_file, NGSIM_LANE_CHANGING).drawn
    found = blurred(drawn, NGSIM_LANE_CHANGING, (0.2, 0.3), seed=0)
    changed = (found.state != drawn.state).nonzero()
    assert set(changed[:, 1].tolist()) == {0, 1}  # the leader is given
    assert set(changed[:, 2].tolist()) == {0}
    assert set(changed[:, 3].tolist()) == {3, 5}
    assert torch.equal(found.action, drawn.action)


def test_every_window_is_tested_once_by_a_model_that_never_saw_its_vehicles(
    lane_file: Path, tmp_path: Path, short: None, monkeypatch: pytest.MonkeyPatch
):
    learned, tested = [], []
    tune, measure = recorded_lane_changes.fine_tune, recorded_lane_changes.measure_model

    def fine_tune(model, reward, config, scenes: Scenes, tuning, seed):
        learned.append(scenes)
        tune(model, reward, config, scenes, tuning, seed)

    def measure_model(model, scenes: Scenes, defined_types):
        tested.append(scenes)
        return measure(model, scenes, defined_types)

    monkeypatch.setattr(recorded_lane_changes, "fine_tune", fine_tune)
    monkeypatch.setattr(recorded_lane_changes, "measure_model", measure_model)
    plan = Plan("table2", 1, out=tmp_path, cache=tmp_path, scenario="ngsim_lane_changing", rows=("Supervised",))
    job = jobs_of(plan, SceneFile(lane_file, "abc"))[0]
    run_jobs.run(job, tmp_path, tmp_path)
    result, found = job.result(tmp_path), lane_changes_of(lane_file, NGSIM_LANE_CHANGING)
    whole, folds = tested[0], tested[1:]
    torch.testing.assert_close(whole.state, found.recorded.state)
    assert sum(len(fold) for fold in folds) == len(found.recorded) == len(result["errors"]["rmse_y"])
    for mine, others in zip(folds, learned, strict=True):
        recorded = len(found.recorded) - len(mine)
        assert len(others) == min((1 + 4) * recorded, recorded + len(found.drawn))
        assert not any(torch.equal(a, b) for a in mine.state for b in others.state)
    assert sum(point["scenes"] for point in result["ood"][:1]) == len(found.recorded)
    assert len(result["before"]["errors"]["rmse_x"]) == len(found.recorded)
    written = publish(replace(plan, ngsim=lane_file))
    assert not [path for path in written if "frequencies" in path.name]  # Supervised infers no graphs
