from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import pandas as pd
import pytest

from gri.core.policy import IntelligentDriver
from gri.data.ngsim.extract import extract
from gri.data.ngsim.rules import Rules
from gri.paper import plan, recorded_car_following, rows, run_jobs
from gri.paper.job_cache import Job
from gri.training.fine_tuning import FineTuning
from gri.training.grounded.recorded_traffic import RecordedSettings
from gri.training.grounded.settings import GroundedSettings
from gri.training.train import TrainConfig
from tests.gri.data.ngsim.conftest import as_text, merging, platoon


@pytest.fixture
def following_file(tmp_path: Path) -> Path:
    """Three platoons. Their numbers assign them to the test, training and validation scenes."""
    platoons = [platoon(first_id=n, lane=lane) for lane, n in ((1, 1), (2, 301), (3, 901))]
    path = as_text(pd.concat(platoons), tmp_path / "us-101.txt")
    extract([path], tmp_path / "scenes.parquet", Rules(drawn=0), kinds=("car_following",))
    return tmp_path / "scenes.parquet"


@pytest.fixture
def lane_file(tmp_path: Path) -> Path:
    """Lane changes in two recordings, and platoons to draw others from."""
    tables = [merging(), platoon(3, 120, first_id=301, lane=4), platoon(3, 120, first_id=901, lane=5)]
    again = merging(first_id=101).assign(
        Global_Time=lambda t: t["Global_Time"] + 10**7, Local_Y=lambda t: 1.1 * t["Local_Y"], v_Vel=33.0
    )
    path = as_text(pd.concat([*tables, again]), tmp_path / "us-101.txt")
    extract([path], tmp_path / "lanes.parquet", Rules(changing_stride=None), ("lane_changing_h1", "lane_changing_h2"))
    return tmp_path / "lanes.parquet"


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Recorded rows train for one update in this process, and the IDM keeps its defaults."""
    read = rows.read_train_config

    def tiny(path: Path) -> TrainConfig:
        config = read(path)
        objective = config.objective
        if isinstance(objective, RecordedSettings):
            grounded = GroundedSettings(updates=1, likelihood="stepwise", batch=2, return_batch=2, encoder_lead=1)
            objective = RecordedSettings(grounded=grounded, reward_updates=1, reward_batch=2)
        else:
            objective = msgspec.structs.replace(objective, updates=1)
        return msgspec.structs.replace(
            config,
            objective=objective,
            decoder=msgspec.structs.replace(config.decoder, hidden=8),
            encoder=msgspec.structs.replace(config.encoder, hidden=8),
        )

    def in_this_process(jobs: Sequence[Job], _: int, cache: Path, scenes_folder: Path) -> Iterator[Job]:
        for job in jobs:
            run_jobs.run(job, cache, scenes_folder)
            yield job

    tuned = [
        replace(s, cross_validation=s.cross_validation and replace(s.cross_validation, tuning=FineTuning(updates=1)))
        for s in rows.SCENARIOS
    ]
    monkeypatch.setattr(rows, "SCENARIOS", tuple(tuned))
    monkeypatch.setattr(rows, "read_train_config", tiny)
    monkeypatch.setattr(plan, "run_in_processes", in_this_process)
    monkeypatch.setattr(recorded_car_following.idm, "calibrate", lambda scenes, dt: IntelligentDriver(dt))
