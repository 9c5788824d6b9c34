"""What a worker process does for a batch: check its policies, do one of its runs."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

# The first two are for `run_job`, which imports them late: a worker imports them once, and not every copy of it again.
import cosim.loop.closed_loop
import cosim.runs.run_writing  # noqa: F401
from cosim.batch.run_matrix import Run, key_of
from cosim.batch.spec import LEFT_TO_SUMO, NOMINAL
from cosim.perturb.traffic_demand import perturbed_traffic
from cosim.runs.policy_loading import policy_of
from cosim.runs.run_job import run_job
from cosim.runs.share_job import run_share_job
from cosim.runs.share_policies import share_plans
from cosim.runs.shared_warm_up import SharedWarmUp
from cosim.spec.scenario import Scenario
from gri.errors import InputError


def check_policies(runs: Sequence[Run], tell: Callable[..., None]) -> None:
    """Load every policy once, before anything runs. Errors: `InputError` where one does not fit its scenario."""
    kinds = {
        msgspec.json.encode(msgspec.structs.replace(run.scenario, seed=0, perturbations=())): run
        for run in reversed(runs)
    }
    for run in kinds.values():
        try:
            share_plans(run.scenario) if run.scenario.has_shares else policy_of(run.scenario)
        except InputError as error:
            raise InputError(f"{run.cell}: {error}") from None


def run_task(
    folder: Path, scenario: Scenario, labels: Mapping[str, Any], key: str, prepared: SharedWarmUp | None = None
) -> None:
    """Do one run of a batch into its folder (the function of a `cosim.process.task.Task`).

    `prepared` is the warm-up that it shares with others, if there are any.

    Errors: `InputError` where the key differs from the one that the run has here, and those of `run_job`.
    """
    if key_of(scenario, labels) != key:
        raise InputError(
            "the net, the checkpoint or the versions here are not those that the batch began with; start"
            " `cosim batch` again, with the same installation on every machine"
        )
    if scenario.has_shares:
        return run_share_job(scenario, folder, lambda *_: None, labels=labels, draw=False)
    of_counterparts = {**labels, "policy": LEFT_TO_SUMO}
    if perturbed_traffic(scenario).traffic == scenario.traffic:  # what is perturbed is the driven group only
        of_counterparts |= {"perturbation": NOMINAL, "intensity": None}
    run_job(
        scenario,
        folder,
        lambda *_: None,
        labels=labels,
        counterpart_labels=of_counterparts,
        draw=False,
        prepared=prepared,
    )
