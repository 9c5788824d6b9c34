"""What a killed command left among the temporary files is removed by the next one."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

SURVEY = ("traffic", "us101_car_following", "--duration", "60", "--set", "traffic.warm_up=20")


def start(folder: Path, *arguments: str) -> "subprocess.Popen[str]":
    """A command of which nothing but this folder is the place for temporary files."""
    command, env = [sys.executable, "-m", "cosim", *arguments], {**os.environ, "TMPDIR": str(folder)}
    return subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def found(folder: Path) -> list[Path]:
    """Torch's own folder, one per user, may stay."""
    return [path for path in folder.iterdir() if not path.name.startswith("torchinductor_")]


@pytest.mark.slow
def test_check_and_traffic_leave_nothing_for_good(tmp_path: Path):
    for arguments in (("check", "us101_car_following"), SURVEY):
        process = start(tmp_path, *arguments)
        while len(found(tmp_path)) < 2 and process.poll() is None:  # that of the command, and that of its worker
            time.sleep(0.02)
        process.kill()
        process.communicate()
        assert process.returncode == -9, "it had ended"
        assert found(tmp_path), "a killed process removes nothing"
    process = start(tmp_path, *SURVEY)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert not found(tmp_path)
