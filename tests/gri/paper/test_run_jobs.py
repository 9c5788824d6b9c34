"""Jobs are trained once, and an interrupted one continues."""

from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
import torch

from gri.core.policy import IntelligentDriver
from gri.paper import recorded_car_following, run_jobs, synthetic_measurements
from gri.paper.job_cache import Job, SceneFile
from gri.paper.plan import Plan, jobs_of
from gri.paper.rows import IDM
from gri.paper.score_frames import curve_frame, released, score_frame

FOLLOWING = Plan("table2", 1, scenario="ngsim_car_following")


def tiny(job: Job) -> Job:
    config = job.training
    data = msgspec.structs.replace(config.data, train=8, validation=2, test=4, expert_updates=1)
    objective = msgspec.structs.replace(config.objective, updates=2, batch=4)
    config = msgspec.structs.replace(config, data=data, objective=objective)
    protocol = replace(job.scenario.protocol, headways=(4.0, 0.0), starts=4)
    return replace(job, config=config, scenario=replace(job.scenario, protocol=protocol))


def test_an_interrupted_job_continues_and_gives_the_same_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    plan = Plan("table1", 1, 20, scenario="car_following", quick=True, rows=("Supervised",))
    job = tiny(jobs_of(plan)[0])
    monkeypatch.setattr(synthetic_measurements, "SAMPLES", 2)
    monkeypatch.setattr(synthetic_measurements, "flip_agreements", lambda *_: None)
    cache, scenes = tmp_path / "jobs", tmp_path / "scenes"
    with monkeypatch.context() as killed:
        killed.setattr(synthetic_measurements, "measure_model", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            run_jobs.run(job, cache, scenes)
    assert not job.is_done(cache)
    trained = (job.folder(cache) / "model.safetensors").stat().st_mtime_ns
    run_jobs.run(job, cache, scenes)
    assert (job.folder(cache) / "model.safetensors").stat().st_mtime_ns == trained
    first = (job.folder(cache) / "result.json").read_bytes()
    run_jobs.run(job, tmp_path / "afresh", scenes)
    assert (job.folder(tmp_path / "afresh") / "result.json").read_bytes() == first
    monkeypatch.setattr(run_jobs, "train", None)  # a finished job is never trained again
    run_jobs.run(job, cache, scenes)
    scores = released(score_frame([job], cache))
    assert set(scores["metric"]) == {"rmse_x", "rmse_v", "training_seconds", "training_cpu_seconds"}
    assert len(curve_frame([job], cache, {})) == 2 * len(job.scenario.protocol.headways)


def test_a_finished_recorded_job_is_not_trained_again(
    following_file: Path, tmp_path: Path, short: None, monkeypatch: pytest.MonkeyPatch
):
    (job,) = (j for j in jobs_of(FOLLOWING, SceneFile(following_file, "abc")) if j.row.name == "Supervised")
    run_jobs.run(job, tmp_path, tmp_path)
    result = job.result(tmp_path)
    assert result["graphs"] is None
    assert {"rmse_x", "rmse_v", "ade", "min_fde"} <= set(result["errors"])
    assert len(result["errors"]["rmse_x"]) == len(result["site"]) == 1
    assert result["ood_types"] == [0, 1]
    monkeypatch.setattr(run_jobs, "train", None)
    run_jobs.run(job, tmp_path, tmp_path)
    assert job.result(tmp_path) == result


def straight_on(start: torch.Tensor, steps: int) -> torch.Tensor:
    """[S, N, T, 3] at the speeds of the start."""
    time = 0.2 * torch.arange(steps)
    x = start[..., :1] + start[..., 1:2] * time
    return torch.stack([x, start[..., 1:2].expand_as(x), torch.zeros_like(x)], -1)


def test_recorded_constant_speed_has_no_error_when_the_driver_keeps_its_speed(
    following_file: Path, tmp_path: Path, short: None, monkeypatch: pytest.MonkeyPatch
):
    def drive(driver: IntelligentDriver, start: torch.Tensor, leader: torch.Tensor) -> torch.Tensor:
        return straight_on(start, leader.shape[1])

    monkeypatch.setattr(recorded_car_following.idm, "drive", drive)
    job = jobs_of(FOLLOWING, SceneFile(following_file, "abc"))[0]
    assert job.row == IDM
    run_jobs.run(job, tmp_path, tmp_path)
    result = job.result(tmp_path)
    assert result["errors"]["rmse_x"][0] == pytest.approx(0.0, abs=0.02)
    assert result["compared"]["wasserstein_speed"] == pytest.approx(0.0, abs=0.02)
