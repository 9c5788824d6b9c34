"""CPU time until the commands and the processes of a run have imported what they need.

    python benchmarks/start_up.py [--rounds 25] [--against FOLDER]

Each round starts one process per row; rows take turns, so that other load of the machine is spread over all. With
`--against` the same rows are measured with the source in another folder (a checkout of another version), in turns with
these ones, and the ratio is printed. Medians of user and system time. The rows of `cosim run` are the time of the
command and of its worker together, until the worker reports that SUMO is about to make its first step; then both are
ended. They need Linux.
"""

import argparse
import os
import resource
import statistics
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

# Runs the command, ends it and its worker at the first report of progress, and prints the CPU time [ticks] of both.
UNTIL_STEPPING = """
import os, signal, sys
from gri import terminal

def used(pid):
    return sum(map(int, open(f"/proc/{pid}/stat").read().rpartition(")")[2].split()[11:13]))

def at_first_step(self, *_):
    workers = open(f"/proc/self/task/{os.getpid()}/children").read().split()
    print(sum(used(pid) for pid in ["self", *workers]), flush=True)
    for pid in workers:
        os.kill(int(pid), signal.SIGKILL)
    os._exit(0)

terminal.ProgressDisplay._show = at_first_step
from cosim.commands.cli import main
main()
"""
ROWS = {
    "gri --help": ["-c", "import sys; from gri.commands.cli import main; sys.argv = ['gri', '--help']; main()"],
    "cosim --help": ["-m", "cosim", "--help"],
    "cosim report, until it reads": ["-m", "cosim", "report", "no_such_folder"],
    "cosim results, until it reads": ["-m", "cosim", "results", "no_such_folder"],
    "the process that waits for a run": ["-c", "import cosim.runs.run"],
    "the process that does a run": ["-c", "import cosim.runs.run_job"],
    "cosim run, until it steps": ["-c", UNTIL_STEPPING, "run", "us101_car_following"],
    "cosim run with the IDM, until it steps": ["-c", UNTIL_STEPPING, "run", "us101_car_following", "--policy", "idm"],
    "torch alone": ["-c", "import torch"],
}


def cpu(arguments: list[str], source: Path) -> float:
    """CPU seconds of one process with the packages of a folder."""
    if UNTIL_STEPPING in arguments:
        path = os.environ | {"PYTHONPATH": str(source)}
        with TemporaryDirectory() as folder:
            done = subprocess.run([sys.executable, *arguments], cwd=folder, env=path, capture_output=True, check=True)
        return int(done.stdout) / os.sysconf("SC_CLK_TCK")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    path = os.environ | {"PYTHONPATH": str(source)}
    subprocess.run([sys.executable, *arguments], cwd=source, env=path, capture_output=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=25)
    parser.add_argument("--against", type=Path)
    options = parser.parse_args()
    here = Path(__file__).parents[1]
    sources = [here] if options.against is None else [here, options.against]
    spent: dict[tuple[str, Path], list[float]] = {}
    for _ in range(options.rounds):
        for name, arguments in ROWS.items():
            for source in sources:
                spent.setdefault((name, source), []).append(cpu(arguments, source))
    for name in ROWS:
        own, *other = (statistics.median(spent[name, source]) for source in sources)
        beside = f", other {other[0]:.2f} s, ratio {own / other[0]:.2f}" if other else ""
        print(f"{name:40s} {own:.2f} s{beside}")


if __name__ == "__main__":
    main()
