"""Units in which the networks see states and give actions."""

import msgspec


class Scale(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A network sees (state − offset) / unit and answers in `action` units. One number per feature, SI units.

    The offset of the position plays no part: networks see positions relative to each other only.
    """

    offset: tuple[float, ...]
    unit: tuple[float, ...]
    action: tuple[float, ...]


CAR_FOLLOWING_PAPER = Scale(offset=(0.0, 5.0, 0.0), unit=(5.0, 2.0, 1.0), action=(1.0,))
CAR_FOLLOWING_US101 = Scale(offset=(0.0, 10.0, 0.0), unit=(15.0, 5.0, 1.5), action=(1.5,))
CAR_FOLLOWING_NGSIM = Scale(offset=(0.0, 9.0, 0.0), unit=(15.0, 5.0, 1.0), action=(1.0,))
LANE_CHANGING_NGSIM = Scale(
    offset=(0.0, -1.0, 12.0, 0.0, 0.0, 0.0), unit=(15.0, 2.0, 5.0, 0.5, 1.0, 0.5), action=(1.0, 0.5)
)
LANE_CHANGING_PAPER = Scale(
    offset=(0.0, -1.75, 5.0, 0.0, 0.0, 0.0), unit=(5.0, 1.75, 2.0, 0.2, 1.0, 0.2), action=(1.0, 0.2)
)
