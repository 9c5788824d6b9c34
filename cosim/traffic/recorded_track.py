"""One recorded vehicle, at the steps of a simulation."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class RecordedTrack:
    """One recorded vehicle in the road frame: one value per simulation step from `first_step` on.

    `s` and `d` [m] are the front bumper's coordinates, `heading` [rad] is relative to the road, `v` is in m/s.
    """

    name: str
    lane: int
    """Number of the lane in which the vehicle appears first."""
    truck: bool
    length: float
    width: float
    first_step: int
    s: Float[np.ndarray, " K"]
    d: Float[np.ndarray, " K"]
    heading: Float[np.ndarray, " K"]
    v: Float[np.ndarray, " K"]

    @property
    def last_step(self) -> int:
        """The last step at which the vehicle is present."""
        return self.first_step + len(self.s) - 1
