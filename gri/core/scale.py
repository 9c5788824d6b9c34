"""Units in which the networks read states and give actions."""

import msgspec


class Scale(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A network reads (state − offset) / unit, and its output is multiplied by `action`.

    One number per feature, in SI units. The offset of the position has no effect: networks read positions relative to
    each other only.
    """

    offset: tuple[float, ...]
    """Of the D state features."""
    unit: tuple[float, ...]
    """Of the D state features."""
    action: tuple[float, ...]
    """Of the A action features."""


CAR_FOLLOWING_PAPER = Scale(offset=(0.0, 5.0, 0.0), unit=(5.0, 2.0, 1.0), action=(1.0,))
CAR_FOLLOWING_US101 = Scale(offset=(0.0, 10.0, 0.0), unit=(15.0, 5.0, 1.5), action=(1.5,))
CAR_FOLLOWING_NGSIM = Scale(offset=(0.0, 9.0, 0.0), unit=(15.0, 5.0, 1.0), action=(1.0,))
LANE_CHANGING_NGSIM = Scale(
    offset=(0.0, -1.0, 12.0, 0.0, 0.0, 0.0), unit=(15.0, 2.0, 5.0, 0.5, 1.0, 0.5), action=(1.0, 0.5)
)
LANE_CHANGING_PAPER = Scale(
    offset=(0.0, -1.75, 5.0, 0.0, 0.0, 0.0), unit=(5.0, 1.75, 2.0, 0.2, 1.0, 0.2), action=(1.0, 0.2)
)
