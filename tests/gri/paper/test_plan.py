"""Which jobs a plan needs, and the names of their folders."""

from dataclasses import replace
from pathlib import Path

import pytest

from gri.errors import InputError
from gri.paper import pages
from gri.paper.job_cache import Job, SceneFile
from gri.paper.plan import Plan, command, jobs_of, make
from gri.paper.rows import IDM, PRIOR_ROWS, RECORDED_ROWS

FILE = SceneFile(Path("scenes.parquet"), "abc")
SYNTHETIC = Plan("table1", 1, 20, scenario="car_following", quick=True)
FOLLOWING = Plan("table2", 2, scenario="ngsim_car_following")
LANES = Plan("table2", 1, scenario="ngsim_lane_changing")


def test_seeds_come_one_after_the_other():
    assert [job.seed for job in jobs_of(replace(SYNTHETIC, seeds=2))] == [0] * 7 + [1] * 7


def test_recorded_rows_come_seed_by_seed_and_transfers_last():
    jobs = jobs_of(replace(FOLLOWING, rows=("GRI", "NRI")), FILE, ["a", "b"])
    assert [(job.row.name, job.seed, job.site) for job in jobs] == [
        (IDM.name, 0, None), ("GRI", 0, None), ("NRI", 0, None), ("GRI", 1, None), ("NRI", 1, None),
        (IDM.name, 0, "a"), (IDM.name, 0, "b"), ("GRI", 0, "a"), ("GRI", 0, "b"),
    ]  # fmt: skip


def test_lane_changes_have_neither_idm_nor_transfers():
    jobs = jobs_of(LANES, FILE, ["a", "b"])
    assert [job.row for job in jobs] == [*RECORDED_ROWS, *PRIOR_ROWS]
    assert {job.site for job in jobs} == {None}


def test_table2_has_both_recorded_scenarios():
    names = [job.scenario.name for job in jobs_of(Plan("table2", 1), FILE)]
    assert list(dict.fromkeys(names)) == ["ngsim_car_following", "ngsim_lane_changing"]


@pytest.mark.parametrize(
    ("plan", "file", "names"),
    [
        (
            Plan("table1", 1),
            None,
            {"paper_car_following-s0-0c1db9aad8", "lane_changing_nri-s0-e14635900d", "lane_changing-s0-2a2bf6758d"},
        ),
        (FOLLOWING, FILE, {"ngsim_car_following_idm-s0-59ff4b1aa3", "ngsim_car_following-s0-i-80-608095e299"}),
        (LANES, FILE, {"ngsim_lane_changing-s0-fd48a3f301", "ngsim_lane_changing_nri-s0-be9647e7c6"}),
    ],
)
def test_folders_of_released_results_keep_their_names(plan: Plan, file: SceneFile | None, names: set[str]):
    """Otherwise every row is trained again. Change them only with a configuration, or with `VERSION`."""
    assert names <= {job.folder(Path()).name for job in jobs_of(plan, file, ["i-80", "us-101"])}


def test_a_synthetic_folder_is_named_after_everything_that_its_result_depends_on(tmp_path: Path):
    job, again = jobs_of(SYNTHETIC)[0], jobs_of(SYNTHETIC)[0]
    assert job.folder(tmp_path) == again.folder(tmp_path)
    others = [replace(job, seed=1), replace(job, row=replace(job.row, defined_types=False))]
    others.append(replace(job, scenario=replace(job.scenario, protocol=replace(job.scenario.protocol, starts=7))))
    assert len({str(other.folder(tmp_path)) for other in [job, *others]}) == 4


def test_a_recorded_folder_is_named_after_everything_that_its_result_depends_on(tmp_path: Path):
    files = [replace(FILE, digest=digest) for digest in ("one", "two")]
    plans = [FOLLOWING, LANES, replace(LANES, quick=True)]
    jobs = [job for file in files for plan in plans for job in jobs_of(plan, file, ["a", "b"])]
    assert len({job.folder(tmp_path) for job in jobs}) == len(jobs)


def test_quick_jobs_have_few_updates():
    for plan in (SYNTHETIC, replace(FOLLOWING, quick=True), replace(LANES, quick=True)):
        for job in jobs_of(plan, FILE):
            assert job.row is IDM or job.training.name.endswith("-quick")
            if job.scenario.cross_validation:
                assert job.scenario.cross_validation.tuning.updates < 10


def test_results_say_the_command_without_folders_of_this_machine():
    text = command(replace(SYNTHETIC, rows=("GRI (paper, contrast)",)))
    wanted = 'gri reproduce table1 --seeds 1 --scenes 20 --scenario car_following --row "GRI (paper, contrast)" --quick'
    assert text == wanted
    text = command(replace(FOLLOWING, ngsim=Path("/here"), finished=True))
    assert text == "gri reproduce table2 --scenario ngsim_car_following --ngsim DIR --seeds 2 --finished"


def test_rows_can_be_chosen():
    assert [job.row for job in jobs_of(Plan("table2", 1, rows=(IDM.name,)), FILE)] == [IDM]
    assert [job.row.name for job in jobs_of(replace(SYNTHETIC, rows=("NRI", "GRI")))] == ["GRI", "NRI"]


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        (replace(SYNTHETIC, rows=("VAE",)), "got row VAE, wanted one of GRI, .*Supervised"),
        (replace(FOLLOWING, rows=("GPT",)), "got row GPT, wanted one of IDM, calibrated, GRI, GRI"),
        (replace(SYNTHETIC, scenario="parking"), "got scenario parking for table1, wanted one of car_.*lane_changing"),
        (replace(FOLLOWING, scenario="lane_changing"), "for table2, wanted one of ngsim_car_following, ngsim_lane"),
    ],
)
def test_unknown_names_list_the_known_ones(plan: Plan, message: str):
    with pytest.raises(InputError, match=message):
        jobs_of(plan)


def test_table2_needs_recorded_scenes():
    with pytest.raises(InputError, match="--ngsim"):
        make(FOLLOWING)


def test_finished_jobs_can_be_used_without_training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    chosen = replace(SYNTHETIC, seeds=2, rows=("GRI", "NRI"), finished=True, cache=tmp_path)
    with pytest.raises(InputError, match="nothing is finished"):
        make(chosen)
    monkeypatch.setattr(Job, "is_done", lambda job, cache: job.row.name == "NRI" or job.seed == 1)
    found = make(chosen)
    assert [(job.row.name, job.seed) for job in found] == [("NRI", 0), ("GRI", 1), ("NRI", 1)]
    assert pages.seed_count(found) == "1 to 2"


def test_nothing_finished_of_recorded_scenes_is_one_error(following_file: Path, tmp_path: Path):
    with pytest.raises(InputError, match="nothing is finished"):
        make(replace(FOLLOWING, ngsim=following_file, cache=tmp_path / "jobs", finished=True))
