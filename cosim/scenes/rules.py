"""What is cut out of traffic: the kinds of scenes, and the rules that candidates must keep."""

from typing import Literal

import msgspec

from cosim.measures.relation_labels import Reduction
from gri.core.edges import EdgeType
from gri.errors import InputError

Kind = Literal["car_following", "merge"]
KINDS: tuple[Kind, ...] = ("car_following", "merge")
HYPOTHESIS: dict[Kind, dict[tuple[int, int], EdgeType]] = {
    "car_following": {(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW},
    "merge": {(2, 0): EdgeType.FOLLOW, (1, 0): EdgeType.CUT_IN, (0, 1): EdgeType.YIELD},
}
"""The graph that the geometry suggests (Sec. VI-C): 0 follows 1 follows 2; 0 merges behind 2, before 1."""
DT = 0.2  # [s], between two steps of a scene
Rarest = Literal["cut_in", "yield", "follow", "none"]
RAREST: tuple[Rarest, ...] = ("cut_in", "yield", "follow", "none")


class Rules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Rules and their numbers; every candidate that breaks one is counted under the first it breaks."""

    following_steps: int = 30
    """T of car following: 6 s."""
    merging_steps: int = 40
    """T of merges: 8 s."""
    least_before: int = 8
    """Steps that vehicle 0 of a merge was seen before the crossing, at least; half of T are wanted."""
    strategic: bool = True
    """Merges are lane changes that a driver must make to go its way; else also those for speed."""
    at_once: int = 2
    """Car-following scenes of the same stretch of time, at most."""
    spacing: float = 50.0
    """Front to front to the vehicle ahead less than this, always when following, at step 0 and the crossing when
    merging [m]."""
    travel: float = 5.0
    """Vehicle 0 moves at least this far [m]."""
    merging_speed: float = 2.0
    """Of vehicle 0 at the crossing, at least [m/s]."""
    sideways: float = 3.0
    """SUMO changes lanes in no time; the file's y takes so long [s] from there on; 0: no time."""
    per_vehicle: int = 2
    """Scenes of one kind that a vehicle may be in."""
    interaction: float = 1.0
    """Time during which somebody reacts to somebody, summed over pairs, at least [s]."""
    least_clear: float = 1.0
    """An interaction that shorter sums up to leaves the reduction to one graph ambiguous [s]."""
    reduction: Reduction = Reduction.STRONGEST
    at_most: dict[Rarest, float] = {}
    """Greatest share of a kind's scenes whose rarest edge is of a type (cut_in, yield, follow, none: from rare)."""

    def steps(self, kind: Kind) -> int:
        """T of a kind."""
        return self.following_steps if kind == "car_following" else self.merging_steps

    @property
    def longest(self) -> int:
        """The greatest T."""
        return max(self.following_steps, self.merging_steps)

    def checked(self) -> "Rules":
        """These rules. Errors: `InputError` where they cannot be used."""
        for kind, share in self.at_most.items():
            if not 0 <= share <= 1:
                raise InputError(f"--at-most: got {share:g} for {kind}, wanted a share from 0 to 1")
        return self
