"""Robustness of `cosim run`, `batch`, `scenes`, `stress` and `gri train` under faults from outside.

    python benchmarks/chaos.py --out /tmp/chaos [--only run,batch] [--kills 12] [--restarts 2] [--seed 1]

Each command is done once undisturbed. Then: processes of it are killed by SIGKILL at random times, the command itself
among them, and it is given again until it ends by itself; two of it are started at once on one folder; no file may
grow beyond a few KB, as on a full disk; single bits of its results are flipped. Afterwards its results must be the same
byte for byte, and nothing unfinished may be left. Exits with 1 otherwise, and if nobody could be killed. Needs `ps`.
"""

import argparse
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pandas as pd
import torch

from cosim.spec.loading import load_scenario
from gri import checkpoint

SMALL = 6_000  # [bytes] of a file on the full disk: less than a table, more than a traceback
TINY = """\
scenarios: [us101_car_following]
policies: {idm: {kind: idm}, constant: {kind: constant_velocity}}
seeds: {first: 1, count: 4}
retries: 100
overrides: {traffic: {warm_up: 30}, horizon: 2.0, watch: 1.0, rest: 0.2, episodes: 2, time_limit: 60}
"""
TRAIN = "paper_car_following_supervised"


@dataclass(frozen=True)
class Case:
    """A command that writes to one place, and how its results are compared."""

    name: str
    words: str
    """The command, as it is given in the folder of an attempt."""
    results: tuple[str, ...]
    """Patterns of the files that must repeat byte for byte."""
    module: str = "cosim"
    content: Callable[[Path], bytes] = Path.read_bytes

    def command(self) -> list[str]:
        return [sys.executable, "-m", self.module, *self.words.split()]

    def found(self, folder: Path) -> dict[str, bytes]:
        """The content of all results in a folder, by name."""
        paths = sorted(path for pattern in self.results for path in folder.glob(pattern))
        return {str(path.relative_to(folder)): self.content(path) for path in paths}


def model(path: Path) -> bytes:
    """The weights of a checkpoint; its provenance has durations."""
    return b"".join(tensor.numpy().tobytes() for tensor in checkpoint.load(path).state_dict().values())


CASES = (
    Case("run", "run tiny.yaml --baseline idm --out out", ("out/*.parquet", "out/scenario.json")),
    Case(
        "batch",
        "batch batch.yaml --workers 2 --retry-failed --out out",
        ("out/groups/*/*.parquet", "out/runs/*/*.parquet"),
    ),
    Case(
        "scenes",
        "scenes us101_car_following --kind car_following --count 60 --per-seed 20 --workers 2 --out out",
        ("out/scenes.parquet",),
    ),
    Case(
        "stress",
        "stress tiny.yaml --policy idm,sumo --perturbation leader_braking --levels 2 --starts 3 --out out",
        ("out/*.parquet",),
    ),
    Case(
        "train",
        "train train.yaml --scenes scenes --out out.safetensors",
        ("out.safetensors",),
        "gri.commands.cli",
        model,
    ),
)


class Attempts:
    """Starts of one command in one folder."""

    def __init__(self, case: Case, folder: Path, rng: random.Random) -> None:
        self.case, self.folder, self.rng, self.kills = case, folder, rng, 0
        folder.mkdir(parents=True)
        write_inputs(folder)
        (folder / "tmp").mkdir()

    def start(self, largest_file: int | None = None) -> "subprocess.Popen[str]":
        def limit() -> None:
            if largest_file is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file))

        return subprocess.Popen(
            self.case.command(),
            cwd=self.folder,
            env={**os.environ, "TMPDIR": str(self.folder / "tmp")},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=limit if largest_file else None,
        )

    def finish(self) -> None:
        """Give the command until it ends well."""
        for _ in range(5):
            process = self.start()
            said = process.communicate()[1]
            if process.returncode == 0:
                return
        raise SystemExit(f"{self.case.name}: exit code {process.returncode}, {said[-500:]}")

    def kill_at_random(self, kills: int, longest: float) -> bool:
        """Kill its processes one after the other until it ends; the last one killed is the command itself.

        Returns whether the command was done before.
        """
        process = self.start()
        for k in range(kills):
            try:
                return process.wait(self.rng.uniform(0.2, longest)) == 0
            except subprocess.TimeoutExpired:
                pass
            victims = [process.pid] if k == kills - 1 else descendants(process.pid) or [process.pid]
            try:
                os.kill(self.rng.choice(victims), signal.SIGKILL)
                self.kills += 1
            except ProcessLookupError:
                continue
        process.communicate()
        return process.returncode == 0


def descendants(root: int) -> list[int]:
    """The processes that a process has started, and those that they have started."""
    listed = subprocess.run(["ps", "-A", "-o", "pid=,ppid="], capture_output=True, text=True, check=True, timeout=60)
    pairs = [tuple(map(int, line.split())) for line in listed.stdout.splitlines()]
    found, waiting = [], [root]
    while waiting:
        parent = waiting.pop()
        children = [pid for pid, of in pairs if of == parent]
        found += children
        waiting += children
    return found


def write_inputs(folder: Path) -> None:
    import msgspec
    import yaml

    from gri.resources import shipped

    scenario = msgspec.to_builtins(load_scenario("us101_car_following"))
    changes = yaml.safe_load(TINY)["overrides"]
    scenario["traffic"].update(changes.pop("traffic"))
    (folder / "tiny.yaml").write_text(yaml.safe_dump(scenario | changes, sort_keys=False))
    (folder / "batch.yaml").write_text(TINY)
    train = yaml.safe_load(shipped("scenarios", "train", f"{TRAIN}.yaml").read_text())
    train["data"] = train.get("data", {}) | {"train": 200, "validation": 20, "test": 50, "expert_updates": 20}
    train["objective"] = train.get("objective", {}) | {"updates": 60}
    (folder / "train.yaml").write_text(yaml.safe_dump(train))


def unfinished(folder: Path) -> list[str]:
    """What should not be there: unfinished files, claims, temporary files; torch's own folder, one per user, may be."""
    endings = (".part", ".partial", ".lock")
    temporary = {path for path in (folder / "tmp").iterdir() if not path.name.startswith("torchinductor_")}
    paths = [path for path in folder.rglob("*") if path.name.endswith(endings) or path in temporary]
    return [str(path.relative_to(folder)) for path in paths]


def flipped_bit(path: Path, rng: random.Random) -> None:
    content = bytearray(path.read_bytes())
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path.write_bytes(content)


def killed(case: Case, begin: Callable[[str], Attempts], seconds: float, options: argparse.Namespace) -> Attempts:
    attempts = begin("killed")
    each = max(options.kills // options.restarts, 1)
    if not any(attempts.kill_at_random(each, seconds / each) for _ in range(options.restarts)):
        attempts.finish()
    return attempts


def two_at_once(case: Case, begin: Callable[[str], Attempts]) -> Attempts:
    attempts = begin("two")
    both = [attempts.start(), attempts.start()]
    said = [process.communicate()[1] for process in both]
    codes = sorted(process.returncode for process in both)
    refusals = [text for text in said if "writes there" in text or "exists already" in text]
    if codes != [0, 2] or len(refusals) != 1:
        raise SystemExit(f"{case.name}: two at once ended with {codes}: {said}")
    return attempts


def full_disk(case: Case, begin: Callable[[str], Attempts]) -> Attempts:
    attempts = begin("full")
    process = attempts.start(SMALL)
    said = process.communicate()[1]
    if process.returncode == 0 or "Traceback" in said:
        raise SystemExit(f"{case.name}: on a full disk exit code {process.returncode}, {said[-800:]}")
    if left := [name for name in unfinished(attempts.folder) if not name.endswith(".lock")]:
        raise SystemExit(f"{case.name}: a full disk left {left}")
    attempts.finish()
    return attempts


def damaged(case: Case, begin: Callable[[str], Attempts], rng: random.Random, reference: Path) -> Attempts | None:
    """Flip a bit in two results of a finished command, and give it again; other commands do nothing twice."""
    attempts = begin("damaged")
    shutil.copytree(reference, attempts.folder, dirs_exist_ok=True)
    if case.name not in ("batch", "stress"):
        return None
    pattern = "out/runs/*/*.parquet" if case.name == "batch" else "out/chunks/*.parquet"
    for path in rng.sample(sorted(attempts.folder.glob(pattern)), 2):
        flipped_bit(path, rng)
    attempts.finish()
    return attempts


def flips(case: Case, folder: Path, rng: random.Random, count: int) -> str:
    """What readers say of a finished run of a bit in one of its tables, `count` times."""
    from cosim.runs.run import open_run
    from gri.errors import InputError

    wanted = [table.to_json(double_precision=15) for table in open_run(folder).tables.values()]
    outcomes = {"refused": 0, "same": 0, "different": 0}
    for k in range(count):
        path = sorted(folder.glob("*.parquet"))[k % 6]
        before = path.read_bytes()
        flipped_bit(path, rng)
        try:
            run = open_run(folder)
            found = [table.to_json(double_precision=15) for table in run.tables.values()]
            whole = path.name != "surroundings.parquet" or run.surroundings is None
            outcomes["same" if found == wanted and whole else "different"] += 1
        except InputError:
            outcomes["refused"] += 1
        path.write_bytes(before)
    if outcomes["different"]:
        raise SystemExit(f"flipped bits: {outcomes}")
    return ", ".join(f"{number} {name}" for name, number in outcomes.items())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", default=",".join(case.name for case in CASES))
    parser.add_argument("--kills", type=int, default=12, help="of each command")
    parser.add_argument("--restarts", type=int, default=2, help="of each command")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for case in CASES:
        if case.name in options.only.split(","):
            rows.append(chaos(case, options))
            print(json.dumps(rows[-1]), flush=True)
    print(pd.DataFrame(rows).to_string(index=False))


def chaos(case: Case, options: argparse.Namespace) -> dict[str, object]:
    """All faults for one command. Ends the benchmark at the first that is not survived."""
    rng, began = random.Random(f"{case.name} {options.seed}"), time.monotonic()
    begin = partial(_begin, case, options.out, rng)
    plain = begin("plain")
    plain.finish()
    seconds, wanted = time.monotonic() - began, case.found(plain.folder)
    if not wanted:
        raise SystemExit(f"{case.name}: no results")
    hit = killed(case, begin, seconds, options)
    if not hit.kills:
        raise SystemExit(f"{case.name}: nobody was killed")
    ended = [hit, two_at_once(case, begin), full_disk(case, begin), damaged(case, begin, rng, plain.folder)]
    for attempts in filter(None, ended):
        found = case.found(attempts.folder)
        if found != wanted:
            different = [name for name in {*found, *wanted} if found.get(name) != wanted.get(name)]
            raise SystemExit(f"{case.name}: other results after {attempts.folder.name}: {sorted(different)}")
        if left := unfinished(attempts.folder):
            raise SystemExit(f"{case.name}: {attempts.folder.name} left {left}")
    bits = flips(case, plain.folder / "out", rng, 400) if case.name == "run" else ""
    facts = {"command": case.name, "kills": hit.kills, "restarts": options.restarts, "files": len(wanted)}
    return facts | {"undisturbed_s": round(seconds), "flipped bits": bits}


def _begin(case: Case, out: Path, rng: random.Random, name: str) -> Attempts:
    return Attempts(case, out / case.name / name, rng)


if __name__ == "__main__":
    main()
