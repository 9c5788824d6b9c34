"""Commands on unusual systems: another language, odd folders, little memory, few descriptors, a clock that jumps.

Wanted is the same result byte for byte, or one line that says what the system refused and nothing left behind.
"""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import yaml

from gri import checkpoint
from gri.resources import shipped
from tests.cosim.conftest import write_short

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="environments of Linux")
ROOT = Path(__file__).parents[1]
COMMANDS = {
    "run": "cosim run short.yaml --baseline idm --out out",
    "scenes": "cosim scenes short.yaml --kind car_following --count 8 --per-seed 8 --workers 1 --out out",
    "stress": "cosim stress short.yaml --policy idm --perturbation leader_braking --levels 1 --starts 1 --out out",
    "batch": "cosim batch batch.yaml --workers 1 --out out",
    "train": "gri.commands.cli train train.yaml --scenes scenes --out out.safetensors",
}
RESULTS = "out/*.parquet", "out/groups/*/*.parquet", "out.safetensors"
CLOCK = """\
import random, time

_time, _chance = time.time, random.Random(1)
time.time = lambda: _time() + _chance.choice((-1e5, 0.0, 1e5))  # a day back or forth at every look
time.time_ns = lambda: int(1e9 * time.time())
"""


@dataclass(frozen=True)
class System:
    """What is unusual: the name of the folder of the command, its environment, limits, and what it is started by."""

    folder: str = "plain"
    environment: Mapping[str, str | None] = field(default_factory=dict)
    """None removes a variable; FOLDER in a value is the folder in which the test works."""
    limits: str = ""
    """What `ulimit` is given."""
    started_by: tuple[str, ...] = ()
    may_refuse: bool = False
    """Whether the command may end with one line that says so. It does not have to."""


NOBODY = {"HOME": None, "USER": None, "LOGNAME": None}
SYSTEMS = {
    "C, umlauts, no HOME": System("Straße mit Löchern", {"LC_ALL": "C", "LANG": None, **NOBODY}),
    "no UTF-8": System("Straße mit Löchern", {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}),
    "Turkish, read-only TMPDIR": System(
        "%20 & 'so'", {"LC_ALL": "tr_TR.UTF-8", "LOCPATH": "FOLDER/locales", "TMPDIR": "/proc"}
    ),
    "unknown locale, 64 descriptors": System(environment={"LC_ALL": "xx_XX.UTF-8"}, limits="-n 64"),
    "full TMPDIR": System(
        started_by=("unshare", "-rm", "sh", "-c", 'mount -t tmpfs -o size=4k full "$TMPDIR" && exec "$@"', "sh"),
        may_refuse=True,
    ),
    "1.2 GB": System(limits="-v 1200000", may_refuse=True),
    "0.4 GB": System(limits="-v 400000", may_refuse=True),
    "a clock that jumps": System(environment={"PYTHONPATH": f"FOLDER/clock{os.pathsep}{ROOT}"}),
}


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with a Turkish locale, in which the decimal point is a comma, and with a clock that jumps."""
    folder = tmp_path_factory.mktemp("systems")
    (folder / "clock").mkdir()
    (folder / "clock" / "sitecustomize.py").write_text(CLOCK)
    (folder / "locales").mkdir()
    if shutil.which("localedef"):
        made = folder / "locales" / "tr_TR.UTF-8"
        subprocess.run(["localedef", "-i", "tr_TR", "-f", "UTF-8", made], capture_output=True, check=False)
    return folder


@pytest.fixture(scope="module")
def usual(place: Path) -> Callable[[str], dict[str, bytes]]:
    """The results of a command on this system as it is; each is computed once."""
    known: dict[str, dict[str, bytes]] = {}

    def results(command: str) -> dict[str, bytes]:
        if command not in known:
            done, work = _ended(command, System(), place, place / f"{command}, usual")
            assert done.returncode == 0, done.stderr
            known[command] = _results(work)
        return known[command]

    return results


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_a_command_gives_the_same_results_or_refuses_in_one_line(command, name, place, usual):
    system = SYSTEMS[name]
    _skip_where_the_system_cannot_be_had(system, place)
    done, work = _ended(command, system, place, place / f"{command}, {name}")
    assert not _left(work)
    if done.returncode == 0 or not system.may_refuse:
        assert done.returncode == 0, done.stderr
        assert _results(work) == usual(command)
    else:
        assert done.returncode in (1, 2)
        assert "Traceback" not in done.stderr, done.stderr
        said = [
            line for line in (done.stdout + done.stderr).splitlines() if re.match("error: |0 of 1 finished, 1 f", line)
        ]
        assert len(said) == 1, done.stderr
        assert not _results(work)


def test_no_command_asks_the_kernel_about_its_processes():
    """Kernels are built without /proc/PID/task/TID/children; nothing here reads that, nor any other file of /proc."""
    sources = [path for package in ("gri", "cosim") for path in (ROOT / package).rglob("*.py")]
    assert sources
    assert not [path for path in sources if "/proc" in path.read_text(encoding="utf-8")]


def _ended(command: str, system: System, place: Path, outer: Path) -> tuple[subprocess.CompletedProcess[str], Path]:
    """The command once it has ended on a system, and the folder in which it was given."""
    work, temporary = outer / system.folder, outer / "temporary"
    work.mkdir(parents=True)
    temporary.mkdir()
    _write_inputs(work)
    environment = {**os.environ, "TMPDIR": str(temporary), "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    for name, value in system.environment.items():
        environment.pop(name, None)
        if value is not None:
            environment[name] = value.replace("FOLDER", str(place))

    limited = ("sh", "-c", f'ulimit {system.limits} && exec "$@"', "sh") if system.limits else ()
    words = [*system.started_by, *limited, sys.executable, "-m", *COMMANDS[command].split()]
    done = subprocess.run(words, cwd=work, env=environment, capture_output=True, encoding="utf-8", timeout=300)
    return done, work


def _write_inputs(folder: Path) -> None:
    changes = {"horizon": 1.0, "watch": 1.0, "rest": 0.2, "episodes": 2, "time_limit": 60}
    write_short(folder / "short.yaml", **changes)
    batch = {"scenarios": ["short.yaml"], "policies": {"idm": {"kind": "idm"}}, "seeds": [1]}
    (folder / "batch.yaml").write_text(yaml.safe_dump(batch))
    train = yaml.safe_load(shipped("scenarios", "train", "paper_car_following_supervised.yaml").read_text())
    train["data"] = train.get("data", {}) | {"train": 40, "validation": 10, "test": 10, "expert_updates": 5}
    train["objective"] = train.get("objective", {}) | {"updates": 5}
    (folder / "train.yaml").write_text(yaml.safe_dump(train))


def _results(folder: Path) -> dict[str, bytes]:
    paths = [path for pattern in RESULTS for path in sorted(folder.glob(pattern))]
    return {str(path.relative_to(folder)): _content(path) for path in paths}


def _content(path: Path) -> bytes:
    """The content of a file of results; of a checkpoint the weights, as its provenance has durations."""
    if path.suffix != ".safetensors":
        return path.read_bytes()
    return b"".join(tensor.numpy().tobytes() for tensor in checkpoint.load(path).state_dict().values())


def _left(work: Path) -> list[str]:
    """What should not be there: unfinished files, claims, temporary files; torch keeps a folder of its own."""
    unfinished = [path for path in work.rglob("*") if path.name.endswith((".part", ".partial", ".lock"))]
    temporary = [path for path in (work.parent / "temporary").iterdir() if not path.name.startswith("torchinductor_")]
    return [str(path) for path in (*unfinished, *temporary)]


def _skip_where_the_system_cannot_be_had(system: System, place: Path) -> None:
    if "LOCPATH" in system.environment and not any((place / "locales").iterdir()):
        pytest.skip("needs localedef and the sources of locales")
    if system.started_by:
        trial = subprocess.run([*system.started_by, "true"], env={**os.environ, "TMPDIR": str(place)}, check=False)
        if trial.returncode:
            pytest.skip("needs the right to mount a folder")
