"""Small reproductions from end to end: one row, two processes, resumed."""

import json
from dataclasses import replace
from pathlib import Path

import msgspec
import pandas as pd
import pytest

from gri.errors import InputError
from gri.evaluation.out_of_distribution import Front
from gri.paper import jobs, publish, reproduce, rows, tables
from gri.paper.jobs import Job
from gri.paper.reproduce import Plan, jobs_of
from gri.paper.rows import ROWS, SCENARIOS, config_of, printed, rows_of, scenario_named


def plan(folder: Path, **changes) -> Plan:
    base = Plan("table1", 1, 20, folder, folder / "jobs", folder / "scenes", "car_following", quick=True)
    return replace(base, **changes)


def test_every_car_following_row_has_a_configuration():
    scenario = scenario_named("car_following")
    assert [row.name for row in scenario.rows if config_of(scenario, row) is None] == []
    assert {row.name for row in rows_of(scenario, "table3")} == {
        "GRI",
        "GRI (paper, contrast)",
        "GRI-VAIRL",
        "GRI-AIRL",
    }


def test_rows_stand_beside_printed_ones():
    figures = printed()
    for scenario in SCENARIOS:
        for row in scenario.rows:
            assert row.printed is None or not scenario.paper or row.printed in figures[scenario.paper]
    assert figures["car_following"]["NRI"].accuracy == (66.70, 0.0)
    assert figures["lane_changing"]["GRI"].y == (0.207, 0.046)


def test_a_job_is_named_after_all_that_its_result_depends_on(tmp_path: Path):
    job = jobs_of(plan(tmp_path))[0]
    again = jobs_of(plan(tmp_path))[0]
    assert job.folder(tmp_path) == again.folder(tmp_path)
    others = [replace(job, seed=1), replace(job, row=replace(job.row, meaning=False))]
    others.append(replace(job, scenario=replace(job.scenario, protocol=replace(job.scenario.protocol, starts=7))))
    assert len({str(other.folder(tmp_path)) for other in [job, *others]}) == 4


def test_seeds_come_one_after_the_other(tmp_path: Path):
    assert [job.seed for job in jobs_of(plan(tmp_path, seeds=2))] == [0] * 7 + [1] * 7


def test_results_say_the_command_without_anybodys_folders(tmp_path: Path):
    text = reproduce.command(plan(tmp_path, rows=("GRI (paper, contrast)",)))
    wanted = 'gri reproduce table1 --seeds 1 --scenes 20 --scenario car_following --row "GRI (paper, contrast)" --quick'
    assert text == wanted


def test_rows_can_be_chosen(tmp_path: Path):
    assert [job.row.name for job in jobs_of(plan(tmp_path, rows=("NRI", "GRI")))] == ["GRI", "NRI"]
    with pytest.raises(InputError, match="Supervised"):
        jobs_of(plan(tmp_path, rows=("VAE",)))


def test_an_unknown_scenario_lists_the_known_ones(tmp_path: Path):
    with pytest.raises(InputError, match="lane_changing"):
        jobs_of(plan(tmp_path, scenario="parking"))


def tiny(job: Job) -> Job:
    data = msgspec.structs.replace(job.config.data, train=8, validation=2, test=4, expert_updates=1)
    objective = msgspec.structs.replace(job.config.objective, updates=2, batch=4)
    config = msgspec.structs.replace(job.config, data=data, objective=objective)
    protocol = replace(job.scenario.protocol, headways=(4.0, 0.0), starts=4)
    return replace(job, config=config, scenario=replace(job.scenario, protocol=protocol))


def test_an_interrupted_job_goes_on_and_gives_the_same_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    job = tiny(next(job for job in jobs_of(plan(tmp_path)) if job.row.name == "Supervised"))
    monkeypatch.setattr(jobs, "SAMPLES", 2)
    monkeypatch.setattr(jobs, "flips", lambda *_: None)
    cache, scenes = tmp_path / "jobs", tmp_path / "scenes"
    with monkeypatch.context() as killed:
        killed.setattr(jobs, "examine", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            jobs.run(job, cache, scenes)
    assert not job.is_done(cache)
    trained = (job.folder(cache) / "model.pt").stat().st_mtime_ns
    jobs.run(job, cache, scenes)
    assert (job.folder(cache) / "model.pt").stat().st_mtime_ns == trained
    first = (job.folder(cache) / "result.json").read_bytes()
    jobs.run(job, tmp_path / "afresh", scenes)
    assert (job.folder(tmp_path / "afresh") / "result.json").read_bytes() == first
    monkeypatch.setattr(jobs, "train", None)  # a finished job is never trained again
    jobs.run(job, cache, scenes)
    scores = tables.score_rows([job], cache)
    assert set(scores["metric"]) == {"rmse_x", "rmse_v", "training_seconds", "training_cpu_seconds"}
    assert len(tables.curve_rows([job], cache, {})) == 2 * len(job.scenario.protocol.headways)


def test_a_table_stands_beside_the_papers(tmp_path: Path):
    line = {"scenario": "car_following", "half_width": 0.0, "scenes": 10}
    seeds = [{"seed": 0, "mean": 0.02, "std": 0.01}, {"seed": 1, "mean": 0.04, "std": 0.03}]
    scores = pd.DataFrame(
        [line | {"row": "Supervised", "metric": metric} | seed for seed in seeds for metric in ("rmse_x", "rmse_v")]
        + [line | {"row": "Supervised", "metric": "training_cpu_seconds"} | seed for seed in seeds]
    )
    table = tables.markdown_table(scores, scenario_named("car_following")).splitlines()
    assert len(table) == 3
    cells = [cell.strip() for cell in table[2].strip("|").split("|")]
    assert cells[:3] == ["Supervised", "0.0300 ± 0.0200 [0.0200, 0.0400]", "0.039 ± 0.016"]
    assert cells[5:9] == ["–", "–", "–", "–"]
    assert cells[9] == "2"


def test_what_is_finished_can_be_taken_without_training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    chosen = plan(tmp_path, seeds=2, rows=("GRI", "NRI"), finished=True)
    with pytest.raises(InputError, match="nothing is finished"):
        reproduce.make(chosen)
    monkeypatch.setattr(Job, "is_done", lambda job, cache: job.row.name == "NRI" or job.seed == 1)
    found = reproduce.make(chosen)
    assert [(job.row.name, job.seed) for job in found] == [("NRI", 0), ("GRI", 1), ("NRI", 1)]
    assert publish._seeds(found) == "1 to 2"
    assert reproduce.command(chosen).endswith("--finished")


def test_flips_are_told_by_their_least_seed():
    line = {"scenario": "lane_changing", "row": "GRI"}
    shares = [("flip a", 0, 1.0), ("flip a", 1, 0.97), ("flip b", 0, 0.5), ("rmse_x", 0, 0.1)]
    scores = pd.DataFrame([line | {"metric": metric, "seed": seed, "mean": mean} for metric, seed, mean in shares])
    table = tables.markdown_flips(scores, scenario_named("lane_changing")).splitlines()
    assert table[0] == "| model | a | b |"
    assert table[2] == "| GRI | 97.0 | 50.0 |"
    assert tables.markdown_flips(scores, scenario_named("car_following")) == ""


def test_collisions_stand_in_a_table_without_areas():
    base = {"scenario": "lane_changing", "front": "policy", "success": 1.0}
    curves = pd.DataFrame(
        [base | {"row": "oracle", "seed": -1, "headway": x, "collision": 0.0} for x in (0.0, 4.0)]
        + [base | {"row": "GRI", "seed": 0, "headway": x, "collision": c} for x, c in ((0.0, 0.25), (4.0, 0.0))]
    )
    lanes = scenario_named("lane_changing")
    collisions = tables.markdown_curves(curves, lanes, Front.POLICY, "collision").splitlines()
    assert collisions[-1] == "| GRI | 0.0 | 25.0 |"
    success = tables.markdown_curves(curves, lanes, Front.POLICY).splitlines()
    assert success[-1] == "| GRI | 100.0 | 100.0 | 1.000 | 1.000 | 1 |"


def test_areas_are_compared_with_the_oracle():
    base = {"scenario": "car_following", "front": "policy"}
    curves = pd.DataFrame(
        [base | {"row": "oracle", "seed": -1, "headway": x, "success": 0.5} for x in (0.0, 4.0)]
        + [base | {"row": "GRI", "seed": 0, "headway": x, "success": s} for x, s in ((0.0, 0.0), (4.0, 0.5))]
    )
    found = tables.areas(curves).set_index("row")
    assert found.loc["GRI", "area"] == pytest.approx(0.25)
    assert found.loc["GRI", "share_of_oracle"] == pytest.approx(0.5)


@pytest.mark.slow
def test_every_target_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from gri.paper.publish import publish

    monkeypatch.setattr(rows, "rows_of", lambda scenario, table: tuple(r for r in ROWS if r.name in ("GRI", "NRI")))
    for target in reproduce.TABLES:
        written = publish(plan(tmp_path, target=target))
        assert all(path.stat().st_size > 0 for path in written)
        made = json.loads((tmp_path / f"{target}.json").read_text())
        assert made["seeds"] == [0]
        assert made["jobs"] == 2
    assert (tmp_path / "figures" / "f8_success_car_following.png").is_file()
