"""Starts and episodes as an environment sees them: handles of processes that wait for actions.

`Traffic` starts the process of the traffic and collects its starts. `Drive` is one episode.
"""

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from multiprocessing.connection import Connection, Pipe
from multiprocessing.reduction import recv_handle, send_handle
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from cosim.environments.protocol import (
    ACT,
    DONE,
    END,
    FAILED,
    FORK,
    LEFT_TO_SUMO,
    START,
    WRONG_INPUT,
)
from cosim.process.failures import last_lines
from cosim.process.fork import CAN_FORK
from cosim.spec.scenario import Scenario
from cosim.world.groups import Group
from gri.core.nearby import Nearby
from gri.errors import InputError
from gri.storage.scratch import ScratchFolder

_PROGRAM = """
import sys
from multiprocessing.connection import Connection
link = Connection({fd})
sys.path[:] = link.recv()
from cosim.environments.traffic_process import serve
serve(link)
"""
States = Float[np.ndarray, "V 3 D"]


class Drive:
    """One episode that is being driven: `states` are the present ones, one row per view of the group.

    `nearby` are the vehicles around it, None for learners that do not see them. `facts` are None until the episode has
    ended; then they are its outcome.
    """

    def __init__(self, link: Connection) -> None:
        self._link = link
        self.facts: Mapping[str, Any] | None = None
        self.states, self.nearby = self._answer()

    def send(self, action: Float[np.ndarray, "3 A"]) -> None:
        """Let every vehicle of the group take its action [SI units] for one step; `receive` waits for its end."""
        self._link.send((ACT, action.astype(np.float32)))

    def receive(self) -> None:
        """Wait for the end of a step."""
        self.states, self.nearby = self._answer()

    def branch(self) -> "Drive":
        """A copy of this episode that continues from the present instant on its own."""
        return _fork_of(self._link)

    def close(self) -> None:
        """End the process of the episode."""
        self._link.close()

    def _answer(self) -> tuple[States, Nearby | None]:
        try:
            kind, value = self._link.recv()
        except (EOFError, ConnectionResetError):
            raise RuntimeError("the process of the episode ended without an answer; reset the environment") from None
        if kind == FAILED:
            raise RuntimeError(f"the episode failed:\n{value}")
        if kind == END:
            value, self.facts = value
        states, nearby = value
        return states, None if nearby is None else _nearby(nearby)


def _nearby(found: Mapping[str, np.ndarray | None]) -> Nearby:
    values = {name: None if value is None else torch.from_numpy(value) for name, value in found.items()}
    return Nearby(**values)  # pyright: ignore[reportArgumentType]


def _fork_of(link: Connection) -> Drive:
    ours, theirs = Pipe()
    link.send((FORK, None))
    send_handle(link, theirs.fileno(), 0)
    theirs.close()
    return Drive(ours)


@dataclass(frozen=True)
class Start:
    """A group at its take-over. `lane_width` [m] is that of the lane into which it merges; None in car following."""

    group: Group
    lane_width: float | None
    link: Connection

    def begin(self) -> Drive:
        """A new episode from this start."""
        return _fork_of(self.link)


class Traffic:
    """The warmed-up traffic of a scenario, in processes of its own.

    The processes end with `close`, and when this process ends.
    """

    def __init__(self, scenario: Scenario, sees_nearby: bool) -> None:
        if not CAN_FORK:
            raise InputError("environments fork warmed-up traffic, which this system cannot; use Linux or macOS")
        self._scenario = scenario
        self._folder = ScratchFolder()
        self._log = Path(self._folder.name, "sumo.log")
        self._link, theirs = Pipe()
        program = _PROGRAM.format(fd=theirs.fileno())
        self._process = subprocess.Popen(
            [sys.executable, "-c", program], pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL
        )
        theirs.close()
        self._link.send(sys.path)
        self._link.send((scenario, sees_nearby, self._log))

    @cached_property
    def starts(self) -> tuple[Start, ...]:
        """All starts; the first call waits for them.

        Raises `InputError` where the scenario does not run or has no start.
        """
        starts: list[Start] = []
        told = 0
        while True:
            try:
                kind, value = self._link.recv()
            except (EOFError, ConnectionResetError):
                raise RuntimeError(f"the process of the traffic ended: {last_lines(self._log) or '(no log)'}") from None
            if kind == START:
                starts.append(Start(value[0], value[1], Connection(recv_handle(self._link))))
            elif kind == LEFT_TO_SUMO:
                for start in starts[told:]:
                    start.link.send(value)
                told = len(starts)
            elif kind == WRONG_INPUT:
                raise InputError(value)
            elif kind == FAILED:
                raise RuntimeError(f"the process of the traffic failed:\n{value}")
            elif kind == DONE:
                self._process.wait()
                if not starts:
                    limit = self._scenario.time_limit
                    raise InputError(
                        f"group: no group fits the rule within {limit:g} s; loosen it or raise time_limit ({value})"
                    )
                return tuple(starts)

    def close(self) -> None:
        """End all processes of this traffic."""
        for start in self.__dict__.get("starts", ()):
            start.link.close()
        self._link.close()
        self._process.terminate()
        self._process.wait()
        self._folder.cleanup()
