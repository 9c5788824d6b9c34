"""One warm-up for all runs with the same traffic: each goes on in a copy of the process that did it.

Runs share a warm-up if they differ in nothing but the policy and the perturbations of single groups. Their results are
those of runs alone, byte by byte: a copy is started only if SUMO would be started with the same files and arguments.
"""

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from cosim.process.own_process import print_to
from cosim.spec.input_files import find_net, sha256
from cosim.spec.scenario import Scenario
from cosim.sumo import sumo_errors
from cosim.traffic.scratch_files import scratch_folder
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from cosim.traffic.warm_up import WarmTraffic, warm_traffic


@dataclass(frozen=True)
class SharedWarmUp:
    """Traffic at the end of its warm-up, the hash of its route file, and what SUMO has said so far.

    `log` is SUMO's log as the system knows it (device and number), as the file has no name any more.
    """

    traffic: WarmTraffic
    routes_sha256: str
    messages: bytes
    log: tuple[int, int]

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

    def _log_to(self, log: Path) -> None:
        with log.open("ab") as stream:
            stream.write(self.messages)
            stream.flush()
            for name in os.listdir("/dev/fd"):
                with suppress(OSError):  # that of the listing itself is closed by now
                    found = os.fstat(int(name))
                    if (found.st_dev, found.st_ino) == self.log:
                        os.dup2(stream.fileno(), int(name))


@contextmanager
def shared_warm_up(scenario: Scenario, within: str = "") -> Iterator[SharedWarmUp]:
    """Run the warm-up of a scenario (the function of a `cosim.process.task.Preparation`).

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
        yield SharedWarmUp(traffic, routes, messages, (found.st_dev, found.st_ino))
