"""The state of a training as a file, from which a training that was stopped goes on where it was.

A training is a sequence of stages of updates. `TrainingState.updates` is the loop of a stage. Between two updates all
that later ones depend on is: the parameters that the stage trains, the optimisers, the random generators, and numbers
such as the multiplier β. They are written every minute and when the training is stopped. When it is started once more,
stages that had ended give the parameters that they ended with, and the stage that was stopped goes on after its last
update. What is computed between stages, such as posteriors, is computed again. The result has the same bytes as that of
a training that was never stopped (docs/decisions/067-training-goes-on.md).
"""

import hashlib
import signal
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import torch
from safetensors import safe_open
from safetensors.torch import save as packed
from torch import Tensor

from gri.checkpoint import tensor_digest
from gri.core.scenes import Scenes
from gri.errors import InputError, guarded_reading
from gri.storage.verification import DamagedError
from gri.storage.whole_files import write_whole
from gri.training.optimisation import Descent

FORMAT = "gri-training-state"
REMEDY = "remove it to begin anew"
SAVE_INTERVAL = 60.0  # [s] between two times that the file is written


class _Stage(msgspec.Struct, kw_only=True):
    """How far a stage is, and what its descents and its memory are but tensors."""

    name: str
    done: int
    total: int
    memory: dict[str, float] = {}
    descents: list[dict[str, Any]] = []


class _Header(msgspec.Struct, forbid_unknown_fields=True):
    identity: str
    spent: tuple[float, float]
    stages: list[_Stage]
    sha256: str = ""
    """Of all tensors, and of everything else here."""


class TrainingState:
    """Where a training is, kept in the file `path`; with None it is kept nowhere.

    `identity` says what is trained: a file of another identity is refused. `spent` is the time on the clock and of the
    processor [s] that earlier parts took.
    """

    def __init__(self, path: Path | None = None, identity: str = "") -> None:
        self.path, self.identity = path, identity
        self.spent = 0.0, 0.0
        self._stages: list[tuple[_Stage, dict[str, Tensor]]] = []  # those that began, in the past and now
        self._begun = 0  # stages that began in this process
        self._saved = time.monotonic()
        self._began = self._saved, time.process_time()
        self._in_update = self._stop = False
        if path is not None and path.exists():
            self._read(path)

    @property
    def at(self) -> str:
        """How far the training was when the file was written, "" without one."""
        if not self._stages:
            return ""
        last, _ = self._stages[-1]
        return f"update {last.done} of {last.total} of stage {len(self._stages)} ({last.name})"

    def updates(
        self,
        stage: str,
        total: int,
        generator: torch.Generator,
        *descents: Descent,
        memory: MutableMapping[str, float] | None = None,
    ) -> Iterator[int]:
        """The numbers of the updates of a stage that are still to be done; the body of the loop does one of them.

        `descents` are those that the stage uses, `memory` are numbers that one update leaves to the next.
        """
        if self.path is None:
            yield from range(total)
            return
        memory = {} if memory is None else memory
        done = self._restored(stage, total, generator, descents, memory)
        for update in range(done, total):
            self._in_update = True
            yield update
            self._in_update = False
            if self._stop or time.monotonic() - self._saved > SAVE_INTERVAL:
                self._keep(_Stage(name=stage, done=update + 1, total=total), generator, descents, memory)
                self.save()
            if self._stop:
                raise KeyboardInterrupt
        if done < total:
            self._keep(_Stage(name=stage, done=total, total=total), generator, descents, memory)

    def save(self) -> None:
        """Write the file."""
        if self.path is None or not self._stages:
            return
        tensors = {f"{k}.{name}": value for k, (_, of) in enumerate(self._stages) for name, value in of.items()}
        now = time.monotonic(), time.process_time()
        wall, cpu = (before + end - begin for before, end, begin in zip(self.spent, now, self._began, strict=True))
        header = _Header(self.identity, (wall, cpu), [stage for stage, _ in self._stages])
        header.sha256 = _digest(tensors, header)
        write_whole(self.path, packed(tensors, {FORMAT: msgspec.json.encode(header).decode()}))
        self._saved = time.monotonic()

    def finish(self) -> None:
        """Remove the file: the training has ended."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)

    @contextmanager
    def stoppable(self) -> Iterator[None]:
        """Ctrl-C and the signal to terminate end the update under way, write the file, and raise KeyboardInterrupt.

        A second one, or one between stages, ends at once; what was written before stays.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def handle(number: int, frame: object) -> None:
            if self._stop or not self._in_update:
                self.save()
                raise KeyboardInterrupt
            self._stop = True

        before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _restored(
        self,
        name: str,
        total: int,
        generator: torch.Generator,
        descents: Sequence[Descent],
        memory: MutableMapping[str, float],
    ) -> int:
        """How many updates of the stage that begins are done; descents, generators and memory are as after them."""
        number, self._begun = self._begun, self._begun + 1
        if number == len(self._stages):
            self._keep(_Stage(name=name, done=0, total=total), generator, descents, memory)
            return 0
        known, tensors = self._stages[number]
        if (known.name, known.total, len(known.descents)) != (name, total, len(descents)):
            raise InputError(
                f"{self.path}: stage {number + 1} is {known.name!r} of {known.total} updates, wanted {name!r} of"
                f" {total}; remove the file to begin anew"
            )
        with guarded_reading(self.path or "", "state of a training", REMEDY):
            for k, (descent, numbers) in enumerate(zip(descents, known.descents, strict=True)):
                of = {key.removeprefix(f"{k}."): value for key, value in tensors.items() if key.startswith(f"{k}.")}
                descent.restore(of, numbers)
            generator.set_state(tensors["generator"])
            torch.set_rng_state(tensors["global"])
        memory.update(known.memory)
        return known.done

    def _keep(
        self, stage: _Stage, generator: torch.Generator, descents: Sequence[Descent], memory: Mapping[str, float]
    ) -> None:
        """Note the present state of the stage under way."""
        tensors = {"generator": generator.get_state(), "global": torch.get_rng_state()}
        stage.memory = dict(memory)
        for k, descent in enumerate(descents):
            of, numbers = descent.state()
            stage.descents.append(numbers)
            tensors |= {f"{k}.{name}": value for name, value in of.items()}
        self._stages[self._begun - 1 :] = [(stage, tensors)]  # in one step, as a signal can come at any time

    def _read(self, path: Path) -> None:
        with guarded_reading(path, "state of a training", REMEDY), safe_open(path, "pt") as file:
            header = msgspec.json.decode((file.metadata() or {})[FORMAT], type=_Header)
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        if header.sha256 != _digest(tensors, header):
            raise DamagedError(f"{path}: is damaged (its SHA-256 hash is not the recorded one); {REMEDY}")
        if odd := [name for name, of in tensors.items() if of.is_floating_point() and not of.isfinite().all()]:
            raise InputError(f"{path}: its tensor {odd[0][:60]} is not made of finite numbers; {REMEDY}")
        if header.identity != self.identity:
            raise InputError(
                f"{path}: got the state of a training with another configuration, seed, scenes or version; {REMEDY}, or"
                " give another --out"
            )
        self.spent = header.spent
        for k, stage in enumerate(header.stages):
            of = {name.removeprefix(f"{k}."): value for name, value in tensors.items() if name.startswith(f"{k}.")}
            self._stages.append((stage, of))


def _digest(tensors: Mapping[str, Tensor], header: _Header) -> str:
    plain = msgspec.to_builtins(header) | {"sha256": ""}
    return tensor_digest(tensors, msgspec.json.encode(plain, order="sorted").decode())


def identity(config: msgspec.Struct, seed: int, scenes: Scenes) -> str:
    """What makes a training the same one: configuration, seed, the scenes that it learns from, and the versions."""
    return identity_of(config, seed, (scenes.observed, scenes.state, scenes.action))


def identity_of(config: msgspec.Struct, seed: int, tensors: Iterable[Tensor]) -> str:
    """The same of a training that learns from, or starts with, these tensors."""
    total = hashlib.sha256(
        msgspec.json.encode([msgspec.to_builtins(config), seed, version("gri-cosim")], order="sorted")
    )
    total.update(str(torch.__version__).encode())
    for tensor in tensors:
        total.update(f"{tuple(tensor.shape)}".encode() + tensor.detach().numpy().tobytes())
    return total.hexdigest()


def no_state() -> TrainingState:
    """A state that is kept nowhere."""
    return TrainingState()
