"""States of trainings, maps, and options of environments: good inputs, mutations and readers for them."""

import json
import random
import shutil
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save as as_safetensors

from cosim.environments.actions import ActionKind
from cosim.environments.observation import ObservationKind
from cosim.environments.task import task_of
from cosim.proposals import map_file
from gri.checkpoint import tensor_digest
from gri.errors import guarded_reading
from gri.training import training_state
from gri.training.optimisation import Descent
from gri.training.training_state import TrainingState
from gri.yaml_content import content_of
from tests.cosim.proposals.test_map_file import XODR, osm

ODD = (None, [], {}, "", "x", -1, 7, 10**30, float("nan"), [1.0], {"a": 1}, True)


def _training(path: Path) -> tuple[TrainingState, Descent, torch.nn.Linear, torch.Generator]:
    state, net = TrainingState(path, "fuzz"), torch.nn.Linear(3, 2)
    return state, Descent(net.parameters(), 0.01, 6), net, torch.Generator().manual_seed(0)


@cache
def good_state() -> tuple[bytes, ...]:
    """A training that was stopped after its third update of six."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "state")
        state, descent, net, generator = _training(path)
        for update in state.updates("supervised", 6, generator, descent, memory={"beta": 1.0}):
            if update == 3:
                break
            descent.step(net(torch.ones(3)).sum())
            state._saved = -1e9  # so that it is written after this update
        return (path.read_bytes(),)


def read_state(path: Path) -> Any:
    """What a training takes from its state, and the update after that."""
    state, descent, net, generator = _training(path)
    memory: dict[str, float] = {}
    for _ in state.updates("supervised", 6, generator, descent, memory=memory):
        descent.step(net(torch.ones(3)).sum())
        break
    return [*net.parameters(), memory]


def unpacked(content: bytes, format_name: str) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
    """The header of this format, and the tensors, of a file of safetensors."""
    with tempfile.NamedTemporaryFile(suffix=".safetensors") as file:
        Path(file.name).write_bytes(content)
        with safe_open(file.name, "pt") as opened:
            header = json.loads(opened.metadata()[format_name])
            tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118 (it is no mapping)
    return header, tensors


def spoilt_state(rng: random.Random, content: bytes) -> bytes:
    """Drop or spoil a number or a tensor; mostly with a digest that fits again."""
    header, tensors = unpacked(content, training_state.FORMAT)
    name = rng.choice(sorted(tensors))
    rng.choice(
        (
            lambda: _spoil(rng, header),
            lambda: _spoil(rng, header),
            lambda: tensors.pop(name),
            lambda: tensors.__setitem__(name, torch.zeros(rng.choice((0, 1, 7)))),
            lambda: tensors.__setitem__(name, tensors[name].double() * rng.choice((float("nan"), float("inf")))),
            lambda: tensors.__setitem__(
                f"{rng.choice('019')}.{rng.choice(('adam.x', 'adam.9.y', 'z'))}", torch.ones(2)
            ),
        )
    )()
    if rng.random() < 0.8:
        plain = msgspec.json.encode(header | {"sha256": ""}, order="sorted").decode()
        header["sha256"] = tensor_digest(tensors, plain)
    return as_safetensors(tensors, {training_state.FORMAT: json.dumps(header)})


def _spoil(rng: random.Random, tree: Any) -> None:
    while True:
        key = rng.choice(sorted(tree)) if isinstance(tree, dict) else rng.randrange(len(tree))
        if not isinstance(tree[key], dict | list) or not tree[key] or rng.random() < 0.3:
            break
        tree = tree[key]
    if isinstance(tree, dict) and rng.random() < 0.3:
        del tree[key]
    else:
        tree[key] = rng.choice(ODD)


@cache
def good_roads() -> tuple[bytes, ...]:
    return (XODR.encode(),)


@cache
def good_maps() -> tuple[bytes, ...]:
    return (osm().encode(),)


def read_map(path: Path) -> Any:
    """Make net, demand and configuration of a map in another folder, within the time of an input.

    netconvert takes minutes for 100,000 tags inside each other; the limit ends that.
    """
    with tempfile.TemporaryDirectory() as scratch, pytest.MonkeyPatch.context() as patch:
        patch.setattr(map_file, "LIMIT", 8.0)
        map_file.convert(Path(shutil.copy(path, scratch)))


OPTIONS = b"""\
scenario: us101_merge
roles: [0]
action: targets
sees: group
reward: {completed: 2.0, acceleration: -0.001}
overrides: {horizon: 6, seed: 3, perturbations: [{kind: dropout, intensity: 0.5}]}
"""


class Options(msgspec.Struct, forbid_unknown_fields=True):
    """The options that `gymnasium.make` passes on; Python itself refuses others."""

    scenario: str
    roles: tuple[int, ...]
    action: ActionKind
    sees: ObservationKind
    reward: dict[str, float]
    overrides: dict[str, Any]


def read_options(path: Path) -> Any:
    """The task of an environment with these options."""
    with guarded_reading(path, "file of options", "correct it"):
        content = content_of(path.read_text(encoding="utf-8"), path)[0]
        options = msgspec.convert(content, Options)
    task = task_of(**{name: getattr(options, name) for name in options.__struct_fields__})
    return [task.scenario, task.weights]
