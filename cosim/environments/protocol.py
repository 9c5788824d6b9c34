"""The kinds of messages between an environment and the processes of its traffic; light to import.

The traffic tells of each START, then what the same groups did when they were LEFT_TO_SUMO, and at last that it is DONE.
An episode is asked to ACT or to FORK, and answers with its STATE, or with its END; both hold what the policy sees:
the states, and who is nearby.
"""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from gri.core.nearby import Nearby

START, LEFT_TO_SUMO, DONE = "start", "left_to_sumo", "done"
ACT, FORK = "act", "fork"
STATE, END = "state", "end"
WRONG_INPUT, FAILED = "wrong_input", "failed"

Seen = tuple["np.ndarray", "dict[str, np.ndarray | None] | None"]
"""The states, and the fields of who is nearby: arrays, because connections send tensors by way of a server."""


def seen_of(state: Tensor, nearby: Nearby | None) -> Seen:
    """What a policy sees, to be sent."""
    if nearby is None:
        return state.numpy(), None
    found = {field.name: getattr(nearby, field.name) for field in fields(nearby)}
    return state.numpy(), {name: None if value is None else value.numpy() for name, value in found.items()}
