"""The policy of an episode that is driven from another process: it shows its states there and waits for actions.

It is an ordinary `gri.core.policy.Policy`, so the closed loop drives an episode of an environment as it drives any
other. While it waits it can be asked to fork: the copy continues from the same instant over a connection of its own.
That is how an episode starts from warmed-up traffic, and how a counterfactual branch begins.
"""

from contextlib import suppress
from multiprocessing.connection import Connection, Pipe
from multiprocessing.reduction import recv_handle, send_handle

import torch
from jaxtyping import Float
from torch import Tensor

from cosim.environments.protocol import ACT, STATE, Seen, seen_of
from cosim.process.fork import plain_fork
from gri.core.dynamics import Dynamics
from gri.core.nearby import Nearby
from gri.core.policy import PolicyState
from gri.core.trajectory import Trajectory

IDLE = 0.02
"""[s] without a request, after which a spare copy is forked: at once it would take the processor from the episode that
has just begun."""


class WaitingPolicy:
    """Sends the states of its one group over `link`, and returns the action that comes back.

    `link` changes in a copy of the process. The states are those that the policy observes, one row per view. Where it
    `sees_nearby`, it also sends who is around the group.

    The first process, from which all episodes are forked, keeps a spare copy, so that an episode need not wait for its
    fork.
    """

    history_steps = 1

    def __init__(self, link: Connection, dynamics: Dynamics, dt: float, sees_nearby: bool) -> None:
        self.link, self.dynamics, self.dt, self.sees_nearby = link, dynamics, dt, sees_nearby
        self._asked = False  # whether the other side waits for the next states
        self._is_copy = False
        self._spare: Connection | None = None  # to a copy that waits for the connection which it shall serve

    def begin(self, history: Trajectory) -> PolicyState:
        """Nothing to infer."""
        return PolicyState.empty(history)

    def act(
        self, memory: PolicyState, state: Float[Tensor, "B 3 D"], nearby: Nearby | None = None
    ) -> tuple[Float[Tensor, "B 3 A"], PolicyState]:
        """The action of the other side for these states. Raises `EOFError` where that side is gone."""
        seen = seen_of(state, nearby)
        if self._asked:
            self.link.send((STATE, seen))
        while True:
            if not self._is_copy and self._spare is None and not self.link.poll(IDLE):
                self._keep_spare(seen)
            wanted, value = self.link.recv()
            if wanted == ACT:
                self._asked = True
                return torch.from_numpy(value).expand(len(state), -1, -1), memory
            self._fork(seen)

    def _fork(self, seen: Seen) -> None:
        """Fork; the copy serves the connection that comes now, and begins with what is seen at present."""
        link = Connection(recv_handle(self.link))
        if not self._given_to_spare(link) and not plain_fork():
            self._serve(link, seen)
        else:
            link.close()

    def _given_to_spare(self, link: Connection) -> bool:
        """Whether a spare copy serves this connection from now on."""
        spare, self._spare = self._spare, None
        if spare is None:
            return False
        with spare, suppress(OSError):  # it may have been ended, as by a lack of memory
            send_handle(spare, link.fileno(), None)
            return True
        return False

    def _keep_spare(self, seen: Seen) -> None:
        """Fork a copy that waits. Raises `EOFError` in it where the original ends before it is needed."""
        self._spare, waiting = Pipe()
        if plain_fork():
            waiting.close()
            return
        self._spare.close()
        self._spare = None
        self.link.close()  # before it waits: the other side of this link is to notice when the original is gone
        _rehearse(seen)
        self._serve(Connection(recv_handle(waiting)), seen)
        waiting.close()

    def _serve(self, link: Connection, seen: Seen) -> None:
        """Be a copy that serves `link`."""
        self.link.close()  # else the other side would never notice that the original is gone
        self.link, self._is_copy = link, True
        self.link.send((STATE, seen))


def _rehearse(seen: Seen) -> None:
    """Do once what a copy does first: the first use of every page of memory in a new process costs time."""
    one, other = Pipe()
    send_handle(one, other.fileno(), None)
    with Connection(recv_handle(other)) as link:
        link.send((STATE, seen))
        one.recv()
    one.close()
    other.close()
