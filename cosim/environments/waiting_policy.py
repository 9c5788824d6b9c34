"""The policy of an episode that is driven from another process: it shows its states there and waits for actions.

It is an ordinary `gri.core.policy.Policy`, so the closed loop drives an episode of an environment as it drives any
other. While it waits it can be asked to fork: the copy continues from the same instant over a connection of its own.
That is how an episode starts from warmed-up traffic, and how a counterfactual branch begins.
"""

from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle

import torch
from jaxtyping import Float
from torch import Tensor

from cosim.environments.protocol import ACT, STATE, Seen, seen_of
from cosim.process.fork import plain_fork
from gri.core.dynamics import Dynamics
from gri.core.nearby import Nearby
from gri.core.policy import PolicyState
from gri.core.trajectory import Trajectory


class WaitingPolicy:
    """Sends the states of its one group over `link`, and returns the action that comes back.

    `link` changes in a copy of the process. The states are those that the policy observes, one row per view. Where it
    `sees_nearby`, it also sends who is around the group.
    """

    history_steps = 1

    def __init__(self, link: Connection, dynamics: Dynamics, dt: float, sees_nearby: bool) -> None:
        self.link, self.dynamics, self.dt, self.sees_nearby = link, dynamics, dt, sees_nearby
        self._asked = False  # whether the other side waits for the next states

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
            wanted, value = self.link.recv()
            if wanted == ACT:
                self._asked = True
                return torch.from_numpy(value).expand(len(state), -1, -1), memory
            self._fork(seen)

    def _fork(self, seen: Seen) -> None:
        """Fork; the copy serves the connection that comes now, and begins with what is seen at present."""
        link = Connection(recv_handle(self.link))
        if plain_fork():
            link.close()
            return
        self.link.close()  # else the other side would never notice that the original is gone
        self.link = link
        self.link.send((STATE, seen))
