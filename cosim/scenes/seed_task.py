"""What a worker does with one seed of a data set.

Light to import: without torch a process is small, and copies of it for interventions are cheap.
"""

import os
import tempfile
import traceback
from pathlib import Path

import msgspec

from cosim.process.own_process import peak_mb, print_to
from cosim.process.task import LOG, Answer, Task
from cosim.scenes.rules import DT
from cosim.scenes.seed_scenes import Figures, Spec, film
from cosim.spec.input_files import find_net
from cosim.sumo import SumoError
from gri.data.scene_file.schema import Header, writing
from gri.errors import InputError

SCENES, FIGURES = "scenes.parquet", "figures.json"


class SeedResult(msgspec.Struct, frozen=True, kw_only=True):
    """A seed's figures, and of what they are: `key` changes with all that the scenes depend on."""

    key: str
    figures: Figures
    cpu_seconds: float
    """Of the whole process and its copies, start-up of the worker not included."""
    peak_mb: float
    """Resident memory of the process."""


def perform(task: Task) -> Answer:
    """Film the seed that `task.labels["spec"]` describes into the task's folder; every failure becomes an answer."""
    try:
        task.folder.mkdir(parents=True)
        print_to(task.folder / LOG)
        spec = msgspec.json.decode(task.labels["spec"], type=Spec)
        with (
            tempfile.TemporaryDirectory(prefix="cosim-scenes-") as scratch,
            writing(task.folder / SCENES, Header(dt=DT)) as write,
        ):
            figures = film(spec, find_net(spec.scenario.net), Path(scratch), write)
        brought = SeedResult(
            key=task.key, figures=figures, cpu_seconds=round(sum(os.times()[:4]), 3), peak_mb=peak_mb()
        )
        (task.folder / FIGURES).write_bytes(msgspec.json.encode(brought))
    except InputError as error:
        return Answer(task.run, task.folder, "input", str(error))
    except SumoError as error:
        return Answer(task.run, task.folder, "input", f"SUMO refused the scenario: {error}")
    except Exception as error:
        traceback.print_exc()
        return Answer(task.run, task.folder, "error", f"{type(error).__name__}: {error}")
    return Answer(task.run, task.folder, "done")
