"""The files of one simulation, in a folder that is removed afterwards."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cosim.sumo import SumoError
from cosim.traffic.simulation_input import SumoFiles
from gri.errors import InputError
from gri.storage.scratch import ScratchFolder
from gri.storage.whole_files import PART


def scratch_folder(within: Path | None = None) -> tempfile.TemporaryDirectory[str]:
    """A folder inside `within`, or where the system keeps temporary files; it is removed afterwards."""
    if within is None:
        return ScratchFolder()
    return tempfile.TemporaryDirectory(prefix=".scratch-", suffix=PART, dir=within)


@contextmanager
def scratch_files(
    net: Path, within: Path | None = None, log: Path | None = None, what: str = "SUMO refused the scenario"
) -> Iterator[SumoFiles]:
    """Where SUMO reads and writes: in a folder inside `within`, or where the system keeps temporary files.

    What a killed process leaves inside `within` is removed by the next command that claims it, elsewhere by the next
    one that makes a folder there. The log is kept where `log` says so. Errors: `InputError` for what SUMO refuses
    meanwhile.
    """
    with scratch_folder(within) as scratch:
        try:
            yield SumoFiles(net, Path(scratch, "routes.rou.xml"), log or Path(scratch, "sumo.log"))
        except SumoError as error:
            raise InputError(f"{what}: {error}") from error
