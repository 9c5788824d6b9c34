"""Episode: the frozen result of driving one group through one closed-loop run."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Bool, Float

from cosim.groups import Group
from cosim.safety import net_gap, time_to_collision
from gri.graph import InteractionGraph

COLUMNS = ("s", "d", "x", "y", "heading", "v", "a")  # of Episode.state, SI units, frames of cosim/frames.py
SUCCESS_HEADWAY = 2.0  # [m], the paper's δ_f (Sec. VI-E)


class Ending(StrEnum):
    """Why a group was handed back."""

    HORIZON = "horizon"  # driven as long as the scenario says
    CONTACT = "contact"  # the box of vehicle 0 or 1 touched another one
    CUT_IN = "cut_in"  # somebody else drove between two of the group
    LANE_LEFT = "lane_left"  # a vehicle of the group changed its lane
    LOST = "lost"  # a vehicle of the group left the simulation


INTERRUPTED = frozenset({Ending.CUT_IN, Ending.LANE_LEFT, Ending.LOST})


class EventKind(StrEnum):
    TAKEN = "taken"
    HANDED_BACK = "handed_back"
    CONTACT = "contact"  # by our oriented boxes
    SUMO_COLLISION = "sumo_collision"  # in SUMO's own list
    DISAGREEMENT = "disagreement"  # exactly one of the two saw it
    MISPLACED = "misplaced"  # a commanded vehicle is not where, or not as fast as, it was commanded to be
    VANISHED = "vanished"  # a commanded vehicle is gone
    TELEPORT = "teleport"
    HARD_BRAKING = "hard_braking"  # after the hand-back


@dataclass(frozen=True)
class Event:
    time: float
    kind: EventKind
    vehicles: tuple[str, ...]
    detail: str = ""


@dataclass(frozen=True)
class Episode:
    """What one group did, from the beginning of its history to the end of the watch after the hand-back.

    `state` has the features of COLUMNS for the roles 0, 1, 2; `driven` says at which instants vehicles 0 and 1 stood
    where the policy put them. `graph` is what the policy believed (None where it has no notion of a graph).
    """

    driver: str
    group: Group
    time: Float[np.ndarray, " T"]
    state: Float[np.ndarray, "T 3 C"]
    valid: Bool[np.ndarray, "T 3"]
    driven: Bool[np.ndarray, " T"]
    length: Float[np.ndarray, " 3"]
    graph: InteractionGraph | None
    ending: Ending
    end: float
    events: tuple[Event, ...]

    def feature(self, name: str) -> Float[np.ndarray, "T 3"]:
        return self.state[..., COLUMNS.index(name)]

    @property
    def under_way(self) -> Bool[np.ndarray, " T"]:
        """The instants from the take-over to the end of the drive, whoever drove."""
        return (self.time >= self.group.time - 1e-6) & (self.time <= self.end + 1e-6)

    @property
    def gap(self) -> Float[np.ndarray, "T 2"]:
        """Net gaps [m] 0→1 and 1→2."""
        s = self.feature("s")
        return net_gap(s[:, :2], s[:, 1:], self.length[1:])

    @property
    def ttc(self) -> Float[np.ndarray, "T 2"]:
        """Times to collision [s] 0→1 and 1→2."""
        v = self.feature("v")
        return time_to_collision(self.gap, v[:, :2], v[:, 1:])

    @property
    def jerk(self) -> Float[np.ndarray, "T 3"]:
        """Change of acceleration since the previous instant [m/s³]; 0 at the first one."""
        a = self.feature("a")
        return np.vstack([np.zeros((1, 3)), np.diff(a, axis=0) / np.diff(self.time)[:, None]])

    @property
    def success(self) -> bool:
        """Driven to the horizon without contact, every vehicle still behind the next by the paper's δ_f."""
        last = np.flatnonzero(self.under_way)[-1]
        s = self.feature("s")[last]
        return self.ending is Ending.HORIZON and bool((s[1:] - s[:2] >= SUCCESS_HEADWAY).all())
