"""One run from a scenario to a run folder. It runs in a worker process: see `cosim.runs.run`.

SUMO and its warm-up need a third of what is imported for a whole run, so the rest is imported after the warm-up.
"""

from collections.abc import Callable, Mapping
from inspect import getsourcefile
from pathlib import Path
from typing import Any

import msgspec

from cosim.runs.policy_fit import check_named_policy
from cosim.runs.shared_warm_up import SharedWarmUp
from cosim.spec.input_files import input_files, sha256
from cosim.spec.scenario import LeftToSumo, Scenario, UserPolicy
from cosim.traffic.scratch_files import scratch_files
from cosim.traffic.warm_up import warm_traffic


def run_job(
    scenario: Scenario,
    folder: Path,
    tell: Callable[..., None],
    *,
    labels: Mapping[str, Any] | None = None,
    counterpart_labels: Mapping[str, Any] | None = None,
    draw: bool = True,
    policy: Any = None,
    prepared: SharedWarmUp | None = None,
) -> None:
    """Run a scenario and write its tables, its manifest and a picture into an existing folder.

    Args:
        scenario: what to run.
        folder: an existing, empty folder.
        tell: called with (stage, done, total).
        labels: constant columns to put in front of the groups table; a batch says with them which run this is.
        counterpart_labels: the same for the counterparts table; by default `labels`.
        draw: whether to draw a picture of one episode.
        policy: a `gri.Policy` that takes the place of the one that the scenario names.
        prepared: the traffic at the end of the warm-up, in a copy of the process that runs it.

    Raises:
        InputError: the scenario cannot be run as it is.
    """
    check_named_policy(scenario)
    inputs = _inputs(scenario, policy)
    # Code of the user is run before SUMO is, so that its errors come first.
    driver = _driver(scenario, policy) if policy is not None or isinstance(scenario.policy, UserPolicy) else None
    with scratch_files(inputs["net"], folder, folder / "sumo.log") as files:
        traffic = warm_traffic(scenario, files, tell) if prepared is None else prepared.traffic_for(scenario, files.log)
        with traffic as warm:
            from cosim.loop.closed_loop import run_on  # with all of torch
            from cosim.runs.run_writing import write_run  # with all of pandas
            from cosim.runs.traffic_effects import traffic_effects

            driver = driver or _driver(scenario, None)
            outcome = run_on(warm, driver, tell) if prepared is None else prepared.run_on(warm, driver, tell, files.log)
        of_traffic = traffic_effects(scenario, tell, scratch=folder)
        routes = (
            None if scenario.traffic.has_own_files else prepared.routes_sha256 if prepared else sha256(files.routes)
        )
    write_run(
        scenario,
        folder,
        outcome,
        driver,
        inputs,
        routes,
        tell,
        traffic_effects=of_traffic,
        labels=labels,
        counterpart_labels=counterpart_labels,
        draw=draw,
    )


def _driver(scenario: Scenario, policy: Any) -> Any:
    """The `cosim.loop.driving.Driver` of a run; None where SUMO drives."""
    import torch

    from cosim.runs.policy_loading import driver_of

    torch.set_num_threads(1)  # the models are tiny: more threads are slower
    return driver_of(scenario, policy)


def _inputs(scenario: Scenario, policy: Any) -> dict[str, Path]:
    """The files that the run depends on; for a policy object, the file of its class where there is one."""
    if policy is None:
        return input_files(scenario)
    files = input_files(msgspec.structs.replace(scenario, policy=LeftToSumo()))
    try:
        source = Path(getsourcefile(type(policy)) or "")
    except (TypeError, OSError):  # a class that was typed into a notebook
        return files
    return {**files, "policy": source} if source.is_file() else files
