"""One warm-up and one trunk for all runs with the same traffic.

Runs share a warm-up if they differ in nothing but the policy and the perturbations of single groups. Their results are
those of runs alone, byte by byte: a run uses it only if SUMO would be started with the same files and arguments.

A run is done in a copy of the process that did the warm-up. It goes along a trunk that it shares with other runs: one
process waits at each take-over (`cosim.loop.trunk_courses`). Otherwise it goes on by itself from the end of the
warm-up: with a policy of the user, which is made once per run, and where such a process died or too many wait.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from mmap import mmap
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

from cosim.process.own_process import print_to
from cosim.spec.input_files import find_net, sha256
from cosim.spec.scenario import Scenario, UserPolicy
from cosim.sumo import sumo_errors
from cosim.traffic.scratch_files import scratch_folder
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from cosim.traffic.warm_up import Progress, WarmTraffic, warm_traffic
from gri.errors import InputError

if TYPE_CHECKING:
    from cosim.process.frozen_process import FrozenProcess

MOST_WAITING = 40  # processes that wait at take-overs; each has some 20 MB of its own


@dataclass(frozen=True)
class SharedWarmUp:
    """Traffic at the end of its warm-up, the hash of its route file, and what SUMO has said so far.

    `log` is SUMO's log as the system knows it (device and number), as the file has no name any more. `trunk` waits at
    the end of the warm-up; without it every run has a trunk of its own.
    """

    traffic: WarmTraffic
    routes_sha256: str
    messages: bytes
    log: tuple[int, int]
    trunk: "FrozenProcess | None" = None

    @contextmanager
    def traffic_for(self, scenario: Scenario, log: Path) -> Iterator[WarmTraffic]:
        """The traffic for a run of this scenario; to be called in a copy of the process. `log` is SUMO's log now."""
        warm = self.traffic
        inputs = prepare_simulation(scenario, warm.inputs.files, scenario.time_limit)
        same = replace(inputs, scenario=warm.inputs.scenario) == warm.inputs
        assert same, "runs with different traffic were to share a warm-up"
        self._log_to(log)
        with sumo_errors(log):
            yield WarmTraffic(inputs, warm.running, warm.behind)

    def run_on(self, warm: WarmTraffic, driver: Any, progress: Progress, log: Path) -> Any:
        """What `cosim.loop.closed_loop.run_on` returns for a run of this traffic, from what runs share if it can."""
        from cosim.loop.closed_loop import follow, run_on
        from cosim.loop.trunk_courses import CourseLost, SharedCourse

        scenario = warm.inputs.scenario
        if self.trunk is not None and not isinstance(scenario.policy, UserPolicy):
            with suppress(CourseLost):
                course = SharedCourse(self.trunk, scenario)
                outcome = follow(course, scenario, driver, progress)
                with log.open("ab") as stream:
                    stream.write(course.said)
                return outcome
        return run_on(warm, driver, progress)

    def _log_to(self, log: Path) -> None:
        with log.open("ab") as stream:
            stream.write(self.messages)
            stream.flush()
            for descriptor in _open_as(self.log):
                os.dup2(stream.fileno(), descriptor)


def _open_as(file: tuple[int, int]) -> list[int]:
    """The descriptors by which this process has a file open, which is given as the system knows it."""
    found = []
    for name in os.listdir("/dev/fd"):
        with suppress(OSError):  # that of the listing itself is closed by now
            state = os.fstat(int(name))
            if (state.st_dev, state.st_ino) == file:
                found.append(int(name))
    return found


@contextmanager
def _messages(log: tuple[int, int]) -> Iterator[list[bytes]]:
    """Keep what is written to a log meanwhile out of it; it is in the list afterwards."""
    said: list[bytes] = []
    with TemporaryFile() as instead:
        kept = [(descriptor, os.dup(descriptor)) for descriptor in _open_as(log)]
        for descriptor, _ in kept:
            os.dup2(instead.fileno(), descriptor)
        try:
            yield said
        finally:
            for descriptor, copy in kept:
                os.dup2(copy, descriptor)
                os.close(copy)
            instead.seek(0)
            said.append(instead.read())


def _shared_trunk(traffic: WarmTraffic, policies: Sequence[Scenario], log: tuple[int, int]) -> "FrozenProcess":
    """The process at which the trunk of all these runs begins; policies are loaded once, where that succeeds."""
    import pyarrow.parquet  # noqa: F401  # and what each run would import for itself otherwise
    import torch

    import cosim.runs.run_writing
    import cosim.runs.traffic_effects  # noqa: F401
    from cosim.loop.trunk_courses import share_trunk
    from cosim.runs.policy_loading import driver_of

    torch.set_num_threads(1)
    drivers = {}
    for scenario in policies:
        if not isinstance(scenario.policy, UserPolicy):
            with suppress(InputError):  # the run says what is wrong
                drivers[scenario.policy] = driver_of(scenario)

    def driver(scenario: Scenario) -> Any:
        return drivers[scenario.policy] if scenario.policy in drivers else driver_of(scenario)

    waiting = mmap(-1, 1)  # of all copies together; only one of them goes on at a time

    def may_wait() -> bool:
        waiting[0] = min(waiting[0] + 1, MOST_WAITING + 1)
        return waiting[0] <= MOST_WAITING

    return share_trunk(traffic, driver, partial(_messages, log), may_wait)


@contextmanager
def shared_warm_up(scenario: Scenario, within: str = "", *policies: Scenario) -> Iterator[SharedWarmUp]:
    """Run the warm-up of a scenario (the function of a `cosim.process.task.Preparation`).

    `policies` are scenarios of the runs that will share it, one for each policy.

    All that this process prints from now on is in SUMO's log. The files are removed before the runs begin; SUMO has
    them open. They are in a folder inside `within`, if this machine has it: the batch sweeps there what a killed
    process leaves.
    """
    with ExitStack() as stack:
        scratch = stack.enter_context(ExitStack())
        folder = Path(scratch.enter_context(scratch_folder(Path(within) if within and Path(within).is_dir() else None)))
        files = SumoFiles(find_net(scenario.net), folder / "routes.rou.xml", folder / "sumo.log")
        print_to(files.log)
        traffic = stack.enter_context(warm_traffic(scenario, files, lambda *_: None))
        found = files.log.stat()
        routes, messages = sha256(files.routes), files.log.read_bytes()
        scratch.close()
        log = found.st_dev, found.st_ino
        yield SharedWarmUp(traffic, routes, messages, log, _shared_trunk(traffic, policies, log))
