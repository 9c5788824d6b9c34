"""SUMO finds files whose names have letters outside ASCII, whatever the locale says."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gri.resources import shipped

START = """
import sys
from pathlib import Path
from cosim.sumo import sumo
net, log = map(Path, sys.argv[1:])
with sumo(["--net-file", str(net), "--error-log", str(log), "--end", "1", "--no-step-log"], log):
    print("started")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="LC_ALL=C has no other character set elsewhere")
def test_a_folder_with_umlauts_in_the_c_locale(tmp_path: Path):
    folder = tmp_path / "Läufe für später"
    folder.mkdir()
    shutil.copy(shipped("sumo_nets", "us101", "us101.net.xml"), folder / "ünd.net.xml")
    done = subprocess.run(
        [sys.executable, "-c", START, folder / "ünd.net.xml", folder / "lög"],
        env={**os.environ, "LC_ALL": "C"},
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.stdout == "started\n", done.stderr
    assert (folder / "lög").is_file()
