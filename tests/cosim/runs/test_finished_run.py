"""A finished run is read as it was written, or refused."""

import random
from pathlib import Path

import pytest

from cosim.runs.finished_run import read_scenario, verify_run
from cosim.runs.run_results import open_run
from gri.errors import InputError
from tests.cosim.runs.finished import finished_run, flip


def everything(folder: Path) -> list[str]:
    """All that readers of a run get, as text."""
    run = open_run(folder)
    tables = [*run.tables.values(), run.surroundings]
    return [*(table.to_json(double_precision=15) for table in tables), str(run.manifest), str(read_scenario(folder))]


def flips(folder: Path, count: int) -> list[str]:
    """How each flipped bit was taken, the files of the folder in turn; the folder is as before in the end."""
    wanted, rng = everything(folder), random.Random(1)
    files, outcomes = sorted(folder.iterdir()), []
    for k in range(count):
        path = files[k % len(files)]
        bit = rng.randrange(8 * path.stat().st_size)
        flip(path, bit)
        try:
            outcomes.append("same" if everything(folder) == wanted else f"{path.name} bit {bit} differs")
        except InputError as error:
            outcomes.append("refused" if "\n" not in str(error) else f"{path.name} bit {bit}: several lines")
        flip(path, bit)
    assert everything(folder) == wanted
    return outcomes


def test_a_flipped_bit_is_never_silent(tmp_path):
    outcomes = flips(finished_run(tmp_path / "run"), 80)
    assert set(outcomes) <= {"same", "refused"}
    assert outcomes.count("refused") > 70  # "same": in a blank or the name of the hash of the manifest


@pytest.mark.slow
def test_many_flipped_bits_are_never_silent(tmp_path):
    assert set(flips(finished_run(tmp_path / "run"), 400)) <= {"same", "refused"}


@pytest.mark.parametrize(
    "name", ["steps.parquet", "groups.parquet", "surroundings.parquet", "scenario.json", "manifest.json"]
)
def test_a_missing_or_empty_file_is_refused_with_its_name(tmp_path, name):
    path = finished_run(tmp_path / "run") / name
    path.write_bytes(b"")
    with pytest.raises(InputError, match=rf"{name}.*run the scenario again"):
        everything(tmp_path / "run")
    path.unlink()
    with pytest.raises(InputError, match=name):
        everything(tmp_path / "run")
    with pytest.raises(InputError, match=name):
        verify_run(tmp_path / "run")


def test_the_manifest_of_another_run_does_not_fit(tmp_path):
    one, two = finished_run(tmp_path / "one"), finished_run(tmp_path / "two", speed=21.0)
    (two / "manifest.json").replace(one / "manifest.json")
    with pytest.raises(InputError, match="is damaged"):
        open_run(one)


def test_a_run_of_version_0_1_has_hashes_of_its_tables_only(tmp_path):
    folder = finished_run(tmp_path / "run")
    path = folder / "manifest.json"
    lines = [line for line in path.read_text().splitlines() if "own_sha256" not in line and "scenario.json" not in line]
    path.write_text("\n".join(lines).replace('",\n  }', '"\n  }').replace("},\n}", "}\n}"))
    assert everything(folder)
    flip(folder / "steps.parquet", 100)
    with pytest.raises(InputError, match=r"steps.parquet: is damaged"):
        open_run(folder)
