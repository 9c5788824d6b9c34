"""Batch files: what they expand to, what a run's key depends on, and what a person is told about mistakes."""

from collections import Counter
from pathlib import Path

import msgspec
import pytest
import yaml

from cosim.batch.run_matrix import expand, key_of, load_batch
from cosim.spec.loading import shipped_names
from cosim.spec.scenario import ConstantVelocity, Idm, TrainedPolicy
from gri.errors import InputError

GOOD = """\
scenarios: [us101_car_following, i80_car_following]
policies:
  gri: {kind: gri, checkpoint: us101_car_following}
  idm: {kind: idm}
seeds: [3, 5, 8]
overrides:
  horizon: 4.0
  traffic: {warm_up: 30}
variants:
  tight: {group: {max_gap: 20}}
  wide: {group: {max_gap: 60}}
exclude:
  - {scenario: i80_car_following, policy: idm}
  - {variant: wide, seed: 8}
include:
  - {scenario: i80_car_following, policy: idm, variant: wide, seed: 9}
"""


def written(folder: Path, text: str) -> str:
    path = folder / "batch.yaml"
    path.write_text(text)
    return str(path)


def runs_of(folder: Path, text: str):
    return expand(*load_batch(written(folder, text)))


def test_the_matrix_by_hand(tmp_path):
    """2 scenarios × 2 policies × 2 variants × 3 seeds = 24; − 6 (I-80 with IDM) − 3 (wide with seed 8) + 1."""
    runs = runs_of(tmp_path, GOOD)
    assert len(runs) == 24 - 6 - 3 + 1
    assert Counter(run.cell.variant for run in runs) == {"tight": 9, "wide": 7}
    assert not [run for run in runs if run.cell.variant == "wide" and run.cell.seed == 8]
    assert (runs[-1].cell.scenario, runs[-1].cell.policy, runs[-1].scenario.seed) == ("i80_car_following", "idm", 9)
    assert len({run.key for run in runs}) == len(runs)


def test_every_run_is_one_concrete_scenario(tmp_path):
    for run in runs_of(tmp_path, GOOD):
        scenario, cell = run.scenario, run.cell
        assert scenario.seed == cell.seed
        assert isinstance(scenario.policy, {"gri": TrainedPolicy, "idm": Idm}[cell.policy])
        assert scenario.horizon == 4.0
        assert scenario.traffic.warm_up == 30
        assert scenario.traffic.vehicles, "the rest of the traffic stays"
        assert scenario.group.max_gap == {"tight": 20, "wide": 60}[cell.variant]
        assert scenario.group.max_time_gap == 2.5, "the rest of the group rule stays"


def test_what_is_left_out_is_the_scenarios_own(tmp_path):
    (run,) = runs_of(tmp_path, "scenarios: [us101_car_following]\n")
    assert (run.cell.policy, run.cell.seed, run.cell.perturbation, run.cell.variant) == ("gri", 1, "nominal", "plain")
    assert run.cell.intensity is None


def test_a_mapping_with_a_tag_replaces_the_old_one(tmp_path):
    text = "scenarios: [us101_car_following]\noverrides: {policy: {kind: constant_velocity}}\n"
    (run,) = runs_of(tmp_path, text)
    assert isinstance(run.scenario.policy, ConstantVelocity)


def test_scenarios_and_traffic_may_stand_beside_the_batch(tmp_path):
    scenario = yaml.safe_load(Path("scenarios/us101_car_following.yaml").read_text())
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(scenario | {"horizon": 2.0}))
    (tmp_path / "calm.yaml").write_text(
        Path("scenarios/traffic/us101_congested.yaml").read_text().replace("600", "45", 1)
    )
    (run,) = runs_of(tmp_path, "scenarios: [mine.yaml]\noverrides: {traffic: calm.yaml}\n")
    assert (run.cell.scenario, run.scenario.horizon, run.scenario.traffic.warm_up) == ("mine", 2.0, 45)


def test_the_key_depends_on_content_alone(tmp_path, monkeypatch):
    runs = runs_of(tmp_path, GOOD)
    assert [run.key for run in runs] == [run.key for run in runs_of(tmp_path, "# a comment\n" + GOOD)]
    changed = {run.cell: run.key for run in runs_of(tmp_path, GOOD.replace("max_gap: 60", "max_gap: 61"))}
    same = Counter((run.cell.variant, run.key == changed[run.cell]) for run in runs)
    assert same == {("tight", True): 9, ("wide", False): 7}
    scenario, labels = runs[0].scenario, msgspec.to_builtins(runs[0].cell)
    described = msgspec.structs.replace(scenario, description="other words")
    assert key_of(described, labels) == runs[0].key
    net = tmp_path / "moved.net.xml"
    net.write_bytes(Path("sumo_nets/us101/us101.net.xml").read_bytes())
    before = key_of(msgspec.structs.replace(scenario, net=str(net)), labels)
    net.write_text(net.read_text() + "<!-- -->")
    from cosim.batch import run_matrix

    run_matrix._sha256.cache_clear()
    assert key_of(msgspec.structs.replace(scenario, net=str(net)), labels) != before
    monkeypatch.setattr(run_matrix, "version", lambda name: "0")
    assert key_of(scenario, labels) != runs[0].key


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("scenarios:", "scenario:", 1, "field scenario: unknown field; did you mean"),
        ("us101_car_following, i80", "us101_car_folowing, i80", 1, r"field scenarios\[0\]: unknown scenario"),
        ("i80_car_following]", "us101_car_following]", 1, r"field scenarios\[1\]: two scenarios have the name"),
        ("checkpoint: us101", "chekpoint: us101", 3, "field policies.gri.chekpoint: unknown field"),
        ("kind: idm", "kind: idmm", 4, "field policies.idm.kind: invalid value 'idmm'"),
        ("[3, 5, 8]", "[3, -5]", 5, r"field seeds\[1\]: expected `int` >= 0"),
        ("[3, 5, 8]", "{from: 3}", 5, "field seeds.*"),
        ("horizon: 4.0", "horizont: 4.0", 7, "field overrides.horizont: unknown field; did you mean 'horizon'"),
        ("warm_up: 30", "warm_up: soon", 8, "field overrides.traffic.warm_up: expected `float`, got `str`"),
        ("{warm_up: 30}", "us101_congestd", 8, "unknown traffic 'us101_congestd'"),
        ("max_gap: 20", "max_gap: -20", 10, "field variants.tight.group.max_gap: expected `float` > 0.0"),
        ("horizon: 4.0", "horizon: 4.1", 6, "field overrides: horizon is 4.1 s, expected a multiple of step"),
        ("policy: idm}\n  - {variant", "policy: imd}\n  - {variant", 13, "unknown policy 'imd'; did you mean 'idm'"),
        ("{variant: wide, seed: 8}", "{}", 14, "names no field"),
        ("seed: 9}", "seed: 9, intensity: 2}", 16, "a perturbation and its intensity belong together"),
        ("variant: wide, seed: 9}", "variant: wild, seed: 9}", 16, "unknown variant 'wild'; did you mean 'wide'"),
        ("idm, variant: wide, seed: 9", "gri, variant: wide, seed: 3", 16, "the matrix already has this run"),
        ("checkpoint: us101_car_following}", "checkpoint: nobody}", 3, "no checkpoint 'nobody'"),
    ],
)
def test_mistakes_name_the_file_the_line_and_the_field(tmp_path, old, new, line, message):
    assert old in GOOD
    with pytest.raises(InputError, match=message) as error:
        runs_of(tmp_path, GOOD.replace(old, new, 1))
    assert str(error.value).startswith(f"{tmp_path}/batch.yaml:{line}: "), error.value
    assert "\n" not in str(error.value)


def test_nothing_left_to_run(tmp_path):
    with pytest.raises(InputError, match="nothing is left to run"):
        runs_of(tmp_path, "scenarios: [us101_car_following]\nexclude: [{policy: gri}]\n")


@pytest.mark.parametrize("name", shipped_names("scenarios/batch"))
def test_every_shipped_batch_expands(name):
    assert expand(*load_batch(name))
