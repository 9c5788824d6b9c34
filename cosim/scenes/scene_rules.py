"""The kinds of scenes, and the rules that a candidate must satisfy to become a scene."""

from typing import Literal

import msgspec

from cosim.measures.relation_labels import Reduction
from gri.core.edges import EdgeType
from gri.errors import InputError

Kind = Literal["car_following", "merge", "triple"]
KINDS: tuple[Kind, ...] = ("car_following", "merge", "triple")
DEFAULT_KINDS: tuple[Kind, ...] = ("car_following", "merge")
ANY_SIZE: tuple[Kind, ...] = ("car_following",)
"""Kinds with as many vehicles as a group; the others have three."""
TRIPLE_SHARES = {
    "0 follows 1, 1 follows 2": 0.30,
    "0 follows 1": 0.10,
    "1 follows 2": 0.20,
    "0 follows 2": 0.35,
    "nobody follows": 0.05,
}
"""Shares of triples by their graph. The best constant graph is right in 58 % of the pairs whose sender is ahead."""
DT = 0.2  # [s], between two steps of a scene
Rarest = Literal["cut_in", "yield", "follow", "none"]
RAREST: tuple[Rarest, ...] = ("cut_in", "yield", "follow", "none")


def hypothesis(kind: Kind, size: int) -> dict[tuple[int, int], EdgeType]:
    """The graph that the geometry suggests (paper, Sec. VI-C): 0 follows 1 follows 2 ...; or 0 merges between 1 and 2.

    Three vehicles of a triple drive one ahead of the other, in one lane or in two. A key (i, j) says how j reacts to i.
    """
    if kind == "merge":
        return {(2, 0): EdgeType.FOLLOW, (1, 0): EdgeType.CUT_IN, (0, 1): EdgeType.YIELD}
    return {(ahead, ahead - 1): EdgeType.FOLLOW for ahead in range(1, size)}


class Rules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Rules and their parameters. A rejected candidate is counted under the first rule that it violates."""

    following_steps: int = 30
    """Steps T of a car-following scene: 6 s."""
    merging_steps: int = 40
    """Steps T of a merge scene: 8 s."""
    triple_steps: int = 31
    """Steps T of a triple: 6 s from the first to the last."""
    least_before: int = 8
    """Minimum number of steps before the crossing in which vehicle 0 of a merge is on the road section; T/2 are used
    if there are as many."""
    jitter: float = 0.0
    """The lane change of a merge is up to this long [s] before or after the middle of its scene, drawn per vehicle.
    With 0 a constant per step knows when it happens."""
    strategic: bool = True
    """True: a merge is a lane change that the route requires. False: lane changes for speed count, too."""
    at_once: int = 2
    """Maximum number of car-following scenes from the same T steps."""
    triples_at_once: int = 10
    """Maximum number of triples from the same T steps."""
    spacing: float = 50.0
    """Maximum distance from front bumper to front bumper of the vehicle ahead [m]: in car following at all steps, in
    merges at step 0 and at the crossing."""
    triple_spacing: tuple[float, float] = (7.0, 100.0)
    """Minimum and maximum distance from front to front in triples, at all steps [m]."""
    travel: float = 5.0
    """Minimum distance that vehicle 0 travels [m]."""
    merging_speed: float = 2.0
    """Minimum speed of vehicle 0 at the crossing [m/s]."""
    sideways: float = 3.0
    """Duration of a lane change in the file [s]. SUMO changes lanes in one step; 0 keeps this."""
    per_vehicle: int = 2
    """Maximum number of scenes of one kind with the same vehicle."""
    interaction: float = 1.0
    """Minimum time of interaction in a scene, summed over pairs [s]."""
    least_clear: float = 1.0
    """Minimum total time of an interaction [s]; a pair that interacts for less is ambiguous."""
    reduction: Reduction = Reduction.STRONGEST
    """How the labels of all steps become one graph."""
    at_most: dict[Rarest, float] = {}
    """Maximum share of scenes of a kind by the type of their rarest edge; from rare to frequent: cut_in, yield, follow,
    none."""

    def steps(self, kind: Kind) -> int:
        """Steps T of a scene of this kind."""
        return {
            "car_following": self.following_steps,
            "merge": self.merging_steps,
            "triple": self.triple_steps,
        }[kind]

    @property
    def longest(self) -> int:
        """The largest T."""
        return max(map(self.steps, KINDS))

    def checked(self) -> "Rules":
        """These rules, unchanged. Raises `InputError` if a share is not between 0 and 1, or the jitter is too great."""
        for kind, share in self.at_most.items():
            if not 0 <= share <= 1:
                raise InputError(f"--at-most: got {share:g} for {kind}, wanted a share from 0 to 1")
        most = (self.merging_steps // 2 - self.least_before) * DT
        if not 0 <= self.jitter <= most + 1e-9:
            raise InputError(f"--jitter: got {self.jitter:g} s, wanted 0 to {most:g} s")
        return self
