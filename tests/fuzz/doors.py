"""Mutated inputs for every door that needs no simulation to reject them, and what each door must do with them.

A door gets a path and either raises `InputError` in one line or returns a value whose numbers are finite. The mutations
are drawn from a seed, so every input can be made again: `python -m tests.fuzz.doors --door batch --seed 17`.
"""

import argparse
import gzip
import io
import json
import math
import os
import random
import resource
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd
import torch
import yaml
from safetensors.torch import save as as_safetensors

from cosim.batch.run_matrix import expand, load_batch
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario, traffic_content
from cosim.stress.plan import chunks, policies_of, sweeps_of
from cosim.traffic.additional_file import without_outputs
from gri import checkpoint
from gri.core.dynamics import POINT_MASS_1D
from gri.core.graph import FOLLOWING
from gri.data.ngsim.reading import read_chunks
from gri.data.ranges.recorded import SUMO_CAR_FOLLOWING
from gri.data.recordings.reading import recordings_of
from gri.data.scene_file.reading import read, scene_counts
from gri.errors import InputError
from gri.inference.step_relations import by_model
from gri.networks.model import RelationalModel
from gri.resources import shipped
from gri.training.train import read_train_config
from tests.fuzz import folders, other_inputs
from tests.gri.data.recordings import layout_files

SECONDS, MEGABYTES = 10.0, 1500.0  # per input
Mutate = Callable[[random.Random, bytes], bytes]
NUMBERS = (0, -1, 1, 1e-9, 1e9, 1e18, 2**31, 2**63, 10**400, "1.0e+400", ".inf", ".nan", "-.inf", "1:30", "0x10", "1_0")
WRONG: tuple[Any, ...] = (
    None,
    "nonsense",
    "",
    "x" * 5000,
    [],
    {},
    [[]],
    {"a": 1},
    "2026-02-30",
    True,
    "../x",
    "\0",
    "<!--",
)
STRAY = (
    "\t",
    "}",
    "]",
    ": :",
    "\0",
    "&a *a",
    "!!python/object:os.system ",
    "%",
    "!!int ",
    "<<: ",
    "\ufeff",
    "\u2028",
    "- ",
)


@dataclass(frozen=True)
class Door:
    """A reader, a good input for it, and the mutations that fit its format."""

    name: str
    suffix: str
    good: Callable[[], tuple[bytes, ...]]
    read: Callable[[Path], Any]
    mutations: tuple[Mutate, ...]


# Mutations of bytes


def flip(rng: random.Random, content: bytes) -> bytes:
    """Change up to eight bits."""
    changed = bytearray(content)
    for _ in range(rng.randint(1, 8) if changed else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def cut(rng: random.Random, content: bytes) -> bytes:
    """Keep the beginning."""
    return content[: rng.randrange(len(content) + 1)]


def splice(rng: random.Random, content: bytes) -> bytes:
    """Remove, repeat or overwrite a part."""
    begin = rng.randrange(len(content) + 1)
    end = min(begin + rng.choice((1, 4, 16, 256, 4096)), len(content))
    part = rng.choice((b"", content[begin:end] * 2, rng.randbytes(end - begin), b"\0" * (end - begin)))
    return content[:begin] + part + content[end:]


BYTES: tuple[Mutate, ...] = (flip, cut, splice)


# Mutations of YAML


def _places(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from _places(value, (*path, key))


def _changed(rng: random.Random, content: bytes, change: Callable[[Any, Any], None]) -> bytes:
    tree = yaml.safe_load(content)
    place = rng.choice(list(_places(tree)))
    parent = tree
    for key in place[:-1]:
        parent = parent[key]
    change(parent, place[-1])
    return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True).encode()


def wrong_value(rng: random.Random, content: bytes) -> bytes:
    """Put something else in the place of a value."""
    return _changed(rng, content, lambda parent, key: parent.__setitem__(key, rng.choice(WRONG)))


def wrong_number(rng: random.Random, content: bytes) -> bytes:
    """Put an odd number in the place of a value, as plain text."""
    mark = "fuzzed-number"
    marked = _changed(rng, content, lambda parent, key: parent.__setitem__(key, mark))
    return marked.replace(mark.encode(), str(rng.choice(NUMBERS)).encode())


def misspelt(rng: random.Random, content: bytes) -> bytes:
    """Change the name of a field, or repeat an entry."""

    def change(parent: Any, key: Any) -> None:
        if isinstance(parent, list):
            parent.append(parent[key])
        else:
            parent[f"{key}{rng.choice('sxq')}"] = parent.pop(key)

    return _changed(rng, content, change)


def stray(rng: random.Random, content: bytes) -> bytes:
    """Put stray characters somewhere."""
    text = content.decode()
    at = rng.randrange(len(text))
    return (text[:at] + rng.choice(STRAY) + text[at:]).encode()


def endless(rng: random.Random, content: bytes) -> bytes:
    """Add content that multiplies, nests or repeats itself."""
    n = rng.choice((50, 2000, 20_000))
    bombs = (
        "a0: &a0 [x,x,x,x,x,x,x,x,x,x]\n"
        + "".join(f"a{k}: &a{k} [{','.join([f'*a{k - 1}'] * 10)}]\n" for k in range(1, 9)),
        "deep: " + "[" * n,
        "deep: " + "{a: " * n,
        "".join(f"k{k}: 1\n" for k in range(n)),
        f"long: [{'1, ' * n}1]\n",
        f"number: 1{'0' * n}\n",
        f"text: {'x' * n * 10}\n",
    )
    return content.rstrip() + b"\n" + rng.choice(bombs).encode()


YAML: tuple[Mutate, ...] = (wrong_value, wrong_number, misspelt, stray, endless, *BYTES)


# Mutations of XML and of tables


def xml(rng: random.Random, content: bytes) -> bytes:
    """Break the encoding, the tags or the compression of an XML file, or add entities that multiply."""
    head, body = b'<?xml version="1.0" encoding="%s"?>', content[content.find(b"?>") + 2 :]
    entities = b"<!DOCTYPE l [<!ENTITY e0 'ha'>" + b"".join(
        b"<!ENTITY e%d '%s'>" % (k, b"&e%d;" % (k - 1) * 10) for k in range(1, 12)
    )
    return rng.choice(
        (
            head % rng.choice((b"foo", b"utf-7", b"utf-16", b"ascii", b"idna", b"rot13", b"zlib")) + body,
            entities + b"]><net>&e11;</net>",
            gzip.compress(content),
            gzip.compress(content)[: rng.randrange(200)],
            b"<a>" * rng.choice((10, 100_000)),
            b"<routes/>",
            body.replace(b"net", b"\xff\xfe", 1),
        )
    )


def table(rng: random.Random, content: bytes) -> bytes:
    """Drop, rename, retype or spoil a column of a Parquet table."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    whole = pq.read_table(io.BytesIO(content))
    k = rng.randrange(whole.num_columns)
    name = whole.column_names[k]
    values = whole.column(k).to_pandas()
    odd = rng.choice((np.nan, np.inf, -np.inf, 1e300, None, "text", -1))
    changed = values.astype(object).copy()
    changed.iloc[rng.randrange(max(len(changed), 1))] = odd
    try:
        spoilt = rng.choice(
            (
                lambda: whole.drop_columns([name]),
                lambda: whole.rename_columns([*whole.column_names[:k], "x" * 40, *whole.column_names[k + 1 :]]),
                lambda: whole.set_column(k, name, pa.array(values.astype(str))),
                lambda: whole.set_column(k, name, pa.array([None] * whole.num_rows, whole.schema.field(k).type)),
                lambda: whole.set_column(k, name, pa.array(list(changed), whole.schema.field(k).type)),
                lambda: whole.slice(0, rng.randrange(whole.num_rows)),
                lambda: whole.replace_schema_metadata({}),
                lambda: whole.replace_schema_metadata(
                    {b"gri.scenes": rng.choice((b"{}", b"[", b'{"dt": 0}', b"\xff"))}
                ),
                lambda: pa.concat_tables([whole.slice(1), whole.slice(0, 1)]),
            )
        )()
    except (pa.ArrowException, ValueError, TypeError, OverflowError):  # a mutation that this column cannot have
        spoilt = whole.drop_columns([name])
    out = io.BytesIO()
    pq.write_table(spoilt, out)
    return out.getvalue()


def packed(rng: random.Random, content: bytes) -> bytes:
    """Compress a recording, rightly or wrongly, or make it one line, or lines of other lengths."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as opened:
        for k in range(rng.choice((0, 1, 2))):
            opened.writestr(f"part{k}.txt", content)
    return rng.choice(
        (
            gzip.compress(content),
            gzip.compress(content)[: rng.randrange(2, 400)],
            gzip.compress(b"1 " * 5_000_000, 1),
            gzip.compress(b"\n" * 70_000_000, 1),
            archive.getvalue(),
            archive.getvalue()[:-10],
            content.replace(b"\n", b" "),
            content.replace(b" ", b",", rng.randrange(200)),
            b"Vehicle_ID,Vehicle_ID," + content,
            content.replace(b"\n", b"\n1 2 3\n", 2),
        )
    )


def repacked(rng: random.Random, content: bytes) -> bytes:
    """Drop, retype or spoil a field or a tensor of a checkpoint; now and then the digest is made to fit again."""
    header, tensors = other_inputs.unpacked(content, checkpoint.FORMAT)
    name, tensor = rng.choice(sorted(header)), rng.choice(sorted(tensors))
    odd = rng.choice((None, [], {}, "", "{", "[]", 7, float("nan"), "x" * 1000, 2**70))
    config = header["config"]
    field = rng.choice(sorted(config))
    rng.choice(
        (
            lambda: header.pop(name),
            lambda: header.__setitem__(name, odd),
            lambda: tensors.pop(tensor),
            lambda: tensors.__setitem__(tensor, tensors[tensor] * rng.choice((math.nan, math.inf))),
            lambda: tensors.__setitem__(tensor, torch.zeros(rng.choice((0, 1, 7)))),
            lambda: tensors.__setitem__("model.more", torch.zeros(1)),
            lambda: tensors.__setitem__(tensor, tensors[tensor].to(torch.complex64)),
            lambda: config.pop(field),
            lambda: config.__setitem__(field, rng.choice((None, -1, 0, 1e308, 10**12, "x", [], {}))),
            lambda: _deepest(rng, config),
        )
    )()
    if rng.random() < 0.7 and "sha256" in header:
        header["sha256"] = checkpoint.tensor_digest(tensors)
    out = as_safetensors(tensors, {checkpoint.FORMAT: json.dumps(header)})
    if rng.random() < 0.1:  # a header that claims to be far longer than the file
        return rng.randrange(2**63).to_bytes(8, "little") + out[8:]
    return out


def _deepest(rng: random.Random, config: Any) -> None:
    place = rng.choice(list(_places(config)))
    for key in place[:-1]:
        config = config[key]
    config[place[-1]] = rng.choice((0, -1, 1e308, 10**9, 10**12, None, "x"))


# Good inputs


@cache
def _scenario() -> tuple[bytes, ...]:
    return tuple(
        yaml.safe_dump(msgspec.to_builtins(load_scenario(name)), sort_keys=False).encode()
        for name in ("us101_car_following", "us101_merge", "us101_replay", "us101_share")
    ) + tuple(
        yaml.safe_dump(msgspec.to_builtins(load_scenario(name, settings=settings)), sort_keys=False).encode()
        for name, settings in (
            ("us101_merge", ("safety={kind: rss}", "reinfer_s=1", "graph.own_motion=true")),
            (
                "us101_car_following",
                ("predictor=constant_acceleration", "perturbations=[{kind: perception_latency, intensity: 0.4}]"),
            ),
            ("us101_share", ("shares={acc: {share: 0.3, policy: {kind: sumo_model, model: ACC}}}",)),
        )
    )


@cache
def _batch() -> tuple[bytes, ...]:
    return (
        shipped("scenarios", "batch", "us101_drivers.yaml").read_bytes(),
        b"scenarios: [us101_car_following, i80_car_following]\npolicies: {idm: {kind: idm}, own: {kind: gri,"
        b" checkpoint: us101_car_following}}\nseeds: {first: 3, count: 2}\noverrides: {horizon: 4, traffic: {warm_up: 30}}\n"  # noqa: E501
        b"perturbations: {n: {kind: dropout, intensities: [0.5, 1]}}\nvariants: {a: {group: {max_gap: 20}}}\n"
        b"include: [{scenario: i80_car_following, policy: idm, seed: 9}]\nexclude: [{policy: own, intensity: 1.0}]\n",
    )


@cache
def _net() -> tuple[bytes, ...]:
    return (shipped("sumo_nets", "us101", "us101.net.xml").read_bytes(),)


@cache
def _checkpoints() -> tuple[bytes, ...]:
    folder = Path(checkpoint.__file__).parent / "checkpoints"
    return tuple(
        (folder / f"{name}.safetensors").read_bytes()
        for name in ("us101_car_following", "us101_car_following_supervised")
    )


@cache
def _recording() -> tuple[bytes, ...]:
    rows = [
        f"{v} {f} 50 {1118846980200 + 100 * f} {20 + v} {100 + 3 * f + 50 * v} 1 1 15.0 6.0 2 30.0 0.0 {v + 1} 0 0 0 0"
        for v in range(4)
        for f in range(40)
    ]
    return ("\n".join(rows).encode() + b"\n",)


@cache
def _scenes(steps: int = 10) -> tuple[bytes, ...]:
    from gri.data.scene_file.schema import Header, SceneBlock, writing

    rng = np.random.default_rng(0)
    shape = (6, 3, steps)
    names = np.array(["follow", "none", "none", "none", "none", "none"], object)
    features = {name: rng.normal(size=shape) for name in ("x", "v", "a")}
    block = SceneBlock(
        kind="car_following",
        source=np.array(["fuzz"] * 6, object),
        recording=np.array(["0"] * 6, object),
        split=np.array(["train", "test"] * 3, object),
        start=np.zeros(6),
        vehicle=np.arange(18).reshape(6, 3),
        features=features,
        edges=np.tile(names, (6, 1)),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "scenes.parquet")
        with writing(path, Header(dt=0.2)) as write:
            write(block)
        return (path.read_bytes(),)


# Readers


def _read_batch(path: Path) -> Any:
    return [run.scenario for run in expand(*load_batch(str(path)))]


def _read_scenes(path: Path) -> Any:
    scene_counts(path)
    return read(path, "car_following", POINT_MASS_1D, FOLLOWING).trajectory.state[:]


def _infer(path: Path) -> Any:
    """What `gri infer` makes of a scene file, with a model that is loaded once."""
    model = _model()
    return [found.probs for found in by_model(model, SUMO_CAR_FOLLOWING, path, 1.0)]


@cache
def _model() -> RelationalModel:
    return checkpoint.load("us101_car_following")


def _read_checkpoint(path: Path) -> Any:
    model, reward = checkpoint.load(path), checkpoint.load_reward(path)
    checkpoint.objective(path)
    return [*model.state_dict().values(), *(reward.state_dict().values() if reward else ())]


def _read_recording(path: Path) -> Any:
    return [len(chunk) for chunk in read_chunks(path)]


@cache
def _layouts() -> tuple[bytes, ...]:
    """A recording of a few vehicles in the layouts that are one file."""
    traffic = layout_files.traffic(30)
    with tempfile.TemporaryDirectory() as folder:
        writers = (
            layout_files.tidy,
            layout_files.tgsim,
            layout_files.interaction,
            layout_files.i24,
        )
        return tuple(write(traffic, Path(folder, str(k))).read_bytes() for k, write in enumerate(writers))


def _read_layout(path: Path) -> Any:
    return [recording.rows[name] for recording in recordings_of(path) for name in ("x", "y", "speed", "length")]


def _stress_options(path: Path) -> Any:
    words = path.read_bytes().decode("utf-8", "replace").split("|")[:3]
    scenario = load_scenario("us101_car_following")
    kinds, grades, policies = [*words, "", "", ""][:3]
    try:
        numbers = [float(word) for word in grades.split(",") if word.strip()]
    except ValueError:
        raise InputError("intensity: not a number") from None
    sweeps = sweeps_of(kinds.split(","), numbers, scenario)
    return [chunk.scenario for chunk in chunks(scenario, policies_of(policies.split(","), scenario), sweeps, 12)]


def _stress() -> tuple[bytes, ...]:
    return (
        b"headway_ratio|0.2,0.4|idm,gri",
        b"perception_latency|0.2|sumo",
        b"observation_noise,dropout||us101_car_following",
    )


DOORS = (
    Door("scenario", ".yaml", _scenario, lambda path: load_scenario(str(path)), YAML),
    Door("batch", ".yaml", _batch, _read_batch, YAML),
    Door(
        "traffic",
        ".yaml",
        lambda: (shipped("scenarios", "traffic", "us101_congested.yaml").read_bytes(),),
        lambda path: traffic_content(str(path), path),
        YAML,
    ),
    Door(
        "train",
        ".yaml",
        lambda: tuple(path.read_bytes() for path in sorted(shipped("scenarios", "train").glob("paper_car*.yaml"))[:4]),
        lambda path: read_train_config(path) and None,
        YAML,
    ),
    Door("net", ".net.xml", _net, lambda path: str(find_net(str(path))), (xml, *BYTES)),
    Door("additional file", ".add.xml", _net, without_outputs, (xml, *BYTES)),
    Door("checkpoint", ".safetensors", _checkpoints, _read_checkpoint, (repacked, *BYTES)),
    Door("scene file", ".parquet", _scenes, _read_scenes, (table, *BYTES)),
    Door("recording", ".txt", _recording, _read_recording, (packed, *BYTES)),
    Door("recording of any layout", ".csv", _layouts, _read_layout, BYTES),
    Door("scenes to infer from", ".parquet", lambda: _scenes(30), _infer, (table, *BYTES)),
    Door(
        "state of a training",
        ".safetensors",
        other_inputs.good_state,
        other_inputs.read_state,
        (other_inputs.spoilt_state, other_inputs.spoilt_state, *BYTES),
    ),
    Door("OpenStreetMap", ".osm.xml", other_inputs.good_maps, other_inputs.read_map, (xml, *BYTES)),
    Door("OpenDRIVE", ".xodr", other_inputs.good_roads, other_inputs.read_map, (xml, *BYTES)),
    Door("options of environments", ".yaml", lambda: (other_inputs.OPTIONS,), other_inputs.read_options, YAML),
    Door("stress options", ".txt", _stress, _stress_options, BYTES),
    Door("run folder", ".zip", folders.good_run, folders.read_run, folders.inside(BYTES, table)),
    Door("batch folder", ".zip", folders.good_batch, folders.read_batch, folders.inside(BYTES, table)),
)


# The harness


def mutated(door: Door, seed: int) -> bytes:
    """The mutated input of that seed."""
    rng = random.Random(f"{door.name} {seed}")
    content = rng.choice(door.good())
    for _ in range(rng.choice((1, 1, 1, 2))):
        mutation = rng.choice(door.mutations)
        try:
            content = mutation(rng, content)
        except Exception:  # the mutation wants a whole file, and the first one broke it
            content = flip(rng, content)
        if mutation is endless:  # other mutations would walk through all of it
            break
    return content


def problem_with(door: Door, path: Path) -> tuple[str, str]:
    """Read a file through its door: ("refused", ""), ("accepted", "") or ("broken", why it is wrong)."""
    began = time.process_time()
    try:
        value = door.read(path)
        odd = next((number for number in _numbers(value) if not math.isfinite(number)), None)
        outcome = ("accepted", "") if odd is None else ("broken", f"accepted {odd}")
    except InputError as error:
        outcome = ("broken", f"more than a line: {error}") if "\n" in str(error) else ("refused", "")
    except Exception as error:
        outcome = ("broken", f"{type(error).__name__}: {str(error)[:200]}")
    seconds = time.process_time() - began
    return outcome if seconds <= SECONDS else ("broken", f"{seconds:.0f} s of CPU")


def _numbers(value: Any) -> Iterator[float]:
    """All numbers in what a door returned."""
    waiting = [msgspec.to_builtins(value, enc_hook=lambda other: other) if isinstance(value, msgspec.Struct) else value]
    while waiting:
        part = waiting.pop()
        if isinstance(part, float):
            yield part
        elif isinstance(part, torch.Tensor):
            yield from part.double().flatten()[~part.isfinite().flatten()].tolist()[:1]
        elif isinstance(part, msgspec.Struct):
            waiting.append(msgspec.to_builtins(part))
        elif isinstance(part, dict):
            waiting += part.values()
        elif isinstance(part, list | tuple):
            waiting += part


def fuzz(door: Door, seeds: range, folder: Path, megabytes: float = MEGABYTES) -> tuple[Counter[str], list[str]]:
    """How many inputs of a door were refused, accepted and handled wrongly; and one line for each of the last."""
    counts, problems = Counter(), []
    for seed in seeds:
        path = folder / f"fuzzed{door.suffix}"
        path.write_bytes(mutated(door, seed))
        outcome, why = problem_with(door, path)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)
        if peak > megabytes and outcome != "broken":
            outcome, why = "broken", f"{peak:.0f} MB"
        counts[outcome] += 1
        if outcome == "broken":
            problems.append(f"{door.name}, seed {seed}: {why}")
        if set(os.listdir(folder)) - {path.name}:
            problems.append(f"{door.name}, seed {seed}: left {sorted(set(os.listdir(folder)) - {path.name})}")
    return counts, problems


def main() -> None:
    """Fuzz the doors and print a table of the outcomes; exit with 1 if an input was handled wrongly."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=5000, help="number of inputs, over all doors")
    parser.add_argument("--door", choices=[door.name for door in DOORS], help="only this door")
    parser.add_argument("--seed", type=int, help="only this input; it is kept in the working folder")
    given = parser.parse_args()
    doors = [door for door in DOORS if given.door in (None, door.name)]
    every: list[str] = []
    rows = []
    for door in doors:
        if given.seed is not None:
            Path(f"fuzzed{door.suffix}").write_bytes(mutated(door, given.seed))
            print(door.name, given.seed, *problem_with(door, Path(f"fuzzed{door.suffix}")))
            continue
        began = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            counts, problems = fuzz(door, range(-(-given.inputs // len(doors))), Path(folder))
        every += problems
        rows.append({"door": door.name, **{name: counts[name] for name in ("refused", "accepted", "broken")}})
        print(rows[-1], f"{time.monotonic() - began:.0f} s", flush=True)
    if rows:
        print(pd.DataFrame(rows).to_string(index=False))
    print(*every, sep="\n")
    sys.exit(bool(every))


if __name__ == "__main__":
    main()
