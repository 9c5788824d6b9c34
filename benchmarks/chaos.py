"""Robustness of `cosim run`, `scenes`, `stress`, `batch` (also with shards) and `gri train` under faults from outside.

    python benchmarks/chaos.py --out /tmp/chaos [--only run,batch] [--kills 50] [--restarts 5] [--seed 1]

Each command is done once undisturbed. Then rounds begin, each in a new folder: processes of the command are killed by
SIGKILL at random times, in every third case the command itself, and it is given again until it ends well. There are
rounds until enough have been killed. Two of the command are started at once on one folder; no file may grow beyond a
few KB, as on a full disk; single bits of its results, and of what it keeps for later, are flipped. After each of these
its results must be the same byte for byte, and nothing unfinished may be left, no process either. Exits with 1
otherwise. A line of JSON after each command says what was done. Needs `ps`.
"""

import argparse
import json
import os
import random
import resource
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

from cosim.batch.result_listing import groups_of
from cosim.batch.store import BatchStore
from cosim.runs.run_results import open_run
from cosim.spec.loading import load_scenario
from cosim.stress.stress_test import publish_again
from gri import checkpoint
from gri.data.scene_file.schema import opened
from gri.errors import InputError

SMALL = 6_000  # [bytes] of a file on the full disk: less than a table, more than a traceback
TINY = """\
scenarios: [us101_car_following]
policies: {idm: {kind: idm}, constant: {kind: constant_velocity}}
seeds: {first: 1, count: 2}
retries: 100
overrides: {traffic: {warm_up: 20}, horizon: 1.0, watch: 1.0, rest: 0.2, episodes: 2, time_limit: 60}
"""
TRAIN = "paper_car_following_supervised"
ROUND = 6  # kills at most before a command may end
DONE = "exists already"  # says `cosim run` where it was killed after its results were in their place
GONE = 60.0  # [s] after the end of a command that its processes may take to notice it


@dataclass(frozen=True)
class Case:
    """A command that writes to one place, and how its results are compared."""

    name: str
    words: str
    """The command, as it is given in the folder of an attempt."""
    results: tuple[str, ...]
    """Patterns of the files that must repeat byte for byte."""
    kept: str = ""
    """Pattern of finished parts that the same command uses again; empty where there are none."""
    module: str = "cosim"
    content: Callable[[Path], bytes] = Path.read_bytes
    read: Callable[[Path], object] | None = None
    """A reader of the folder of an attempt, of which damaged results are given."""

    def command(self) -> list[str]:
        return [sys.executable, "-m", self.module, *self.words.split()]

    def found(self, folder: Path) -> dict[str, bytes]:
        """The content of all results in a folder, by name."""
        paths = sorted(path for pattern in self.results for path in folder.glob(pattern))
        return {str(path.relative_to(folder)): self.content(path) for path in paths}


def model(path: Path) -> bytes:
    """The weights of a checkpoint; its provenance has durations."""
    return b"".join(tensor.numpy().tobytes() for tensor in checkpoint.load(path).state_dict().values())


def tables_of_run(folder: Path) -> list[str]:
    run = open_run(folder / "out")
    tables = [*run.tables.values(), run.surroundings]
    return [table.to_json(double_precision=15) for table in tables if table is not None]


def rows_of_scenes(folder: Path) -> str:
    return opened(folder / "out/scenes.parquet").read().to_pandas().to_json(double_precision=15)


def tables_of_stress_test(folder: Path) -> list[str]:
    """All tables of a finished stress test, after its report was written again, which compares their hashes."""
    publish_again(folder / "out", draw=False)
    paths = sorted((folder / "out").glob("*.parquet"))
    return [pd.read_parquet(path).to_json(double_precision=15) for path in paths]


def tables_of_batch(folder: Path) -> list[str]:
    """The groups of a finished batch as `cosim results` reads them, and all tables of its runs."""
    runs = [open_run(path) for path in sorted(folder.glob("out/runs/*"))]
    tables = [groups_of(BatchStore(folder / "out")), *(table for run in runs for table in run.tables.values())]
    return [table.to_json(double_precision=15) for table in tables]


CASES = (
    Case("run", "run tiny.yaml --baseline idm --out out", ("out/*.parquet", "out/scenario.json"), read=tables_of_run),
    Case(
        "train",
        "train train.yaml --scenes scenes --out out.safetensors",
        ("out.safetensors",),
        "scenes/*.npz",
        "gri.commands.cli",
        model,
        lambda folder: model(folder / "out.safetensors"),
    ),
    Case(
        "scenes",
        "scenes tiny.yaml --kind car_following --count 20 --per-seed 10 --workers 1 --out out",
        ("out/scenes.parquet",),
        "out/seeds/[0-9]*/scenes.parquet",
        read=rows_of_scenes,
    ),
    Case(
        "stress",
        "stress tiny.yaml --policy idm,sumo --perturbation leader_braking --levels 2 --starts 2 --out out",
        ("out/*.parquet",),
        "out/chunks/*.parquet",
        read=tables_of_stress_test,
    ),
    Case(
        "batch",
        "batch batch.yaml --workers 1 --retry-failed --out out",
        ("out/groups/*/*.parquet", "out/runs/*/*.parquet"),
        "out/runs/*/*.parquet",
        read=tables_of_batch,
    ),
    Case(
        "shards",
        "batch shards.yaml --workers 1 --retry-failed --out out",
        ("out/*s/s*.parquet",),
        "out/*s/s*.*",
        read=tables_of_batch,
    ),
)


class Attempts:
    """Starts of one command in one folder."""

    def __init__(self, case: Case, folder: Path, rng: random.Random) -> None:
        self.case, self.folder, self.rng = case, folder, rng
        self.kills = self.restarts = 0
        self.seen: set[int] = set()  # processes of the command
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
            if process.returncode == 0 or DONE in said:
                return
        raise SystemExit(f"{self.case.name}: exit code {process.returncode}, {said[-500:]}")

    def kill_at_random(self, longest: float) -> None:
        """Kill one process of the command after another, and give it again where that ended it, until it ends well.

        After `ROUND` kills it is left alone: a command that begins anew each time would not end.
        """
        process, most = self.start(), self.kills + ROUND
        while self.kills < most:
            try:
                process.wait(self.rng.uniform(0.1, longest) * self.rng.random())  # more often early than late
                if process.returncode == 0 or DONE in process.communicate()[1]:
                    return
                process = self.start()
                continue
            except subprocess.TimeoutExpired:
                pass
            others = descendants(process.pid)
            self.seen.update(others)
            victim = self.rng.choice(others) if others and self.rng.random() > 1 / 3 else process.pid
            try:
                os.kill(victim, signal.SIGKILL)
            except ProcessLookupError:
                continue
            self.kills += 1
            if victim == process.pid:
                process.wait()
                self.restarts += 1
                process = self.start()
        process.communicate()
        if process.returncode:
            self.finish()

    def left_over(self) -> list[str]:
        """What should not be there any more: unfinished files, claims, temporary files, processes."""
        deadline = time.monotonic() + GONE
        while (processes := self.seen & running()) and time.monotonic() < deadline:
            time.sleep(0.5)
        return unfinished(self.folder) + [f"process {pid}" for pid in sorted(processes)]


def processes() -> list[tuple[int, int]]:
    """All processes that have not ended, each with the one that started it."""
    command = ["ps", "-A", "-o", "pid=,ppid=,stat="]
    listed = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout.splitlines()
    return [(int(pid), int(of)) for pid, of, state in map(str.split, listed) if not state.startswith("Z")]


def running() -> set[int]:
    return {pid for pid, _ in processes()}


def descendants(root: int) -> list[int]:
    """The processes that a process has started, and those that they have started."""
    pairs = processes()
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
    (folder / "shards.yaml").write_text(TINY + "shards: {runs: 2}\n")
    train = yaml.safe_load(shipped("scenarios", "train", f"{TRAIN}.yaml").read_text())
    train["data"] = train.get("data", {}) | {"train": 100, "validation": 10, "test": 10, "expert_updates": 10}
    train["objective"] = train.get("objective", {}) | {"updates": 30}
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


def killed(case: Case, begin: Callable[[str], Attempts], seconds: float, options: argparse.Namespace) -> list[Attempts]:
    """Rounds of kills until there were enough; every round is another folder."""
    rounds: list[Attempts] = []
    while sum(a.kills for a in rounds) < options.kills or sum(a.restarts for a in rounds) < options.restarts:
        rounds.append(begin(f"killed-{len(rounds) + 1}"))
        rounds[-1].kill_at_random(seconds)
        print(f"{case.name}, round {len(rounds)}: {rounds[-1].kills} kills", file=sys.stderr, flush=True)
    return rounds


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


def damaged(case: Case, begin: Callable[[str], Attempts], rng: random.Random) -> Attempts | None:
    """Stop a command once it has finished parts, flip a bit in one of them, and give it again.

    It makes the part again, or refuses it in one line until it is removed. None where there are no parts.
    """
    if not case.kept:
        return None
    attempts = begin("damaged")
    process = attempts.start()
    while process.poll() is None and not [*attempts.folder.glob(case.kept)]:
        time.sleep(0.02)
    process.kill()
    process.communicate()
    if not (parts := sorted(attempts.folder.glob(case.kept))):
        raise SystemExit(f"{case.name}: no finished part was found")
    part = rng.choice(parts)
    flipped_bit(part, rng)
    process = attempts.start()
    said = process.communicate()[1]
    if process.returncode == 2 and "damaged" in said and "Traceback" not in said:
        part.unlink()
    attempts.finish()
    return attempts


def flips(case: Case, folder: Path, rng: random.Random, count: int) -> str:
    """What the reader of finished results says of a bit flipped in one of them, `count` times."""
    if case.read is None:
        return ""
    wanted, outcomes = case.read(folder), {"refused": 0, "same": 0, "different": 0}
    files = sorted(path for pattern in case.results for path in folder.glob(pattern))
    for k in range(count):
        path = files[k % len(files)]
        before = path.read_bytes()
        flipped_bit(path, rng)
        try:
            outcomes["same" if case.read(folder) == wanted else "different"] += 1
        except InputError:
            outcomes["refused"] += 1
        path.write_bytes(before)
    if outcomes["different"]:
        raise SystemExit(f"{case.name}: flipped bits: {outcomes}")
    return ", ".join(f"{number} {name}" for name, number in outcomes.items() if number)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", default=",".join(case.name for case in CASES))
    parser.add_argument("--kills", type=int, default=50, help="of each command")
    parser.add_argument("--restarts", type=int, default=5, help="of each command")
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
    rounds = killed(case, begin, seconds, options)
    others = [two_at_once(case, begin), full_disk(case, begin), damaged(case, begin, rng)]
    for attempts in filter(None, [*rounds, *others]):
        found = case.found(attempts.folder)
        if found != wanted:
            different = [name for name in {*found, *wanted} if found.get(name) != wanted.get(name)]
            raise SystemExit(f"{case.name}: other results after {attempts.folder.name}: {sorted(different)}")
        if left := attempts.left_over():
            raise SystemExit(f"{case.name}: {attempts.folder.name} left {left}")
    kills, restarts = (sum(getattr(a, name) for a in rounds) for name in ("kills", "restarts"))
    facts = {"command": case.name, "rounds": len(rounds), "kills": kills, "restarts": restarts, "files": len(wanted)}
    return facts | {"undisturbed_s": round(seconds), "flipped bits": flips(case, plain.folder, rng, 400)}


def _begin(case: Case, out: Path, rng: random.Random, name: str) -> Attempts:
    return Attempts(case, out / case.name / name, rng)


if __name__ == "__main__":
    main()
