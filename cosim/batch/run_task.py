"""What a worker does with one run, wherever it runs."""

import traceback
from collections.abc import Callable, Sequence

import msgspec

from cosim.batch.run_matrix import Run, key_of
from cosim.process.own_process import peak_mb, print_to
from cosim.process.task import LOG, Answer, Task
from cosim.runs.policy_loading import policy_of
from cosim.runs.run_job import run_job
from gri.errors import InputError


def check(runs: Sequence[Run], tell: Callable[..., None]) -> None:
    """Refuse a batch in which a policy does not fit its scenario, before anything runs."""
    kinds = {
        msgspec.json.encode(msgspec.structs.replace(run.scenario, seed=0, perturbations=())): run
        for run in reversed(runs)
    }
    for run in kinds.values():
        try:
            policy_of(run.scenario)
        except InputError as error:
            raise InputError(f"{run.cell}: {error}") from None


def perform(task: Task) -> Answer:
    """Do the run in this process, which prints into its folder from now on; every failure becomes an answer."""
    try:
        task.folder.mkdir(parents=True)
        print_to(task.folder / LOG)
        if key_of(task.scenario, task.labels) != task.key:
            raise InputError(
                "the net, the checkpoint or the versions here are not those that the batch began with; start"
                " `cosim batch` again, with the same installation on every machine"
            )
        run_job(task.scenario, task.folder, lambda *_: None, labels=task.labels, draw=False)
    except InputError as error:
        return Answer(task.run, task.folder, "input", str(error))
    except OSError as error:
        return Answer(task.run, task.folder, "error", f"{error.strerror or error} ({type(error).__name__})")
    except Exception as error:
        traceback.print_exc()
        return Answer(task.run, task.folder, "error", f"{type(error).__name__}: {error}")
    return Answer(task.run, task.folder, "done", peak_mb=peak_mb())
