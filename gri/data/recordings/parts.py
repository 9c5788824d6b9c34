"""What a person may say about a file, and what a layout makes of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import pandas as pd

Point = Literal["front", "centre", "rear"]


class ReadingOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a person may say about a file."""

    layout: str | None = None
    """Name of a layout; None: it is recognised."""
    columns: dict[str, str] = {}
    """Column of the tidy table -> column of the file, or column*factor."""
    site: str | None = None
    """Name of the site; None: that of the file."""
    axis: tuple[float, float, float, float] | None = None
    """Two points of the road's axis in the plane, in driving direction [m]."""
    lane_edges: tuple[float, ...] = ()
    """Lateral positions of the lines between the lanes [m]."""
    point: Point | None = None
    """Point of the vehicle that positions refer to; None: that of the layout."""
    types: Path | None = None
    """SUMO file with the vehicle types, for lengths and classes of FCD output."""


@dataclass
class Part:
    """What a layout reads at once: a tidy table, or one in a plane (`PLANE_COLUMNS`), of one or several recordings."""

    table: pd.DataFrame
    name: str
    """The file, for errors and notes."""
    point: Point = "front"
    in_plane: bool = False
