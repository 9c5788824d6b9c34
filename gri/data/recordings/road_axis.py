"""From positions in a plane to positions along a road and across it.

The axis of a road is a straight line through two given points, or it is estimated from the vehicles' paths: a
straight line, or a polynomial where that bends by more than `STRAIGHT`. All paths are fitted together, each with a
lateral offset of its own, so that it does not matter which lanes the vehicles use. Vehicles that drive against the axis
are on a road of their own, whose axis is the same line backwards.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from gri.errors import InputError

STRAIGHT = 0.5
"""Largest distance of a bent axis from a straight one that counts as straight [m]."""
LEAST_PATH = 5.0
"""A vehicle that travels less has no direction of its own [m]."""
ACROSS = 45.0
"""A vehicle whose path deviates by more from the axis drives across the road [degrees]."""
DEGREE = 5  # of the polynomial of a bent axis
SAMPLES = 20_000  # rows from which an axis is estimated


@dataclass(frozen=True)
class Axis:
    """A curve v = f(u) in the plane turned by `angle` [rad] about `origin` [m]; f has the coefficients `bend`.

    s [m] is counted along the curve from u = `start`, d [m] to its left.
    """

    origin: tuple[float, float]
    direction: tuple[float, float]
    """Unit vector of u."""
    bend: tuple[float, ...] = ()
    """Coefficients of a polynomial, the highest power first; none: straight."""
    start: float = 0.0
    end: float = 0.0
    """Range of u of the vehicles; s is exact there."""

    def to_road(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """s and d [m] of positions in the plane."""
        (x0, y0), (c, n) = self.origin, self.direction
        u, v = (x - x0) * c + (y - y0) * n, (y - y0) * c - (x - x0) * n
        if not self.bend:
            return u, v
        slope, curvature = np.polyder(self.bend), np.polyder(self.bend, 2)
        foot = u.copy()
        for _ in range(8):  # Newton: the foot is where the connecting line is at right angles to the curve
            f, df, ddf = (np.polyval(p, foot) for p in (self.bend, slope, curvature))
            wrong = (foot - u) + (f - v) * df
            foot = foot - wrong / np.maximum(1 + df**2 + (f - v) * ddf, 0.2)
        f, df = np.polyval(self.bend, foot), np.polyval(slope, foot)
        d = ((v - f) - (u - foot) * df) / np.sqrt(1 + df**2)
        grid = np.arange(self.start - 50, self.end + 51, 1.0)
        step = np.sqrt(1 + np.polyval(slope, (grid[1:] + grid[:-1]) / 2) ** 2)
        return np.interp(foot, grid, np.r_[0.0, np.cumsum(step)]), d


def given_axis(points: tuple[float, float, float, float]) -> Axis:
    """The straight axis from (x, y) to another (x, y) [m]. Errors: `InputError` if both are one point."""
    x0, y0, x1, y1 = points
    length = float(np.hypot(x1 - x0, y1 - y0))
    if not length > 0:
        raise InputError(f"--axis: got the same point twice ({x0:g}, {y0:g}), wanted two points in driving direction")
    return Axis((x0, y0), ((x1 - x0) / length, (y1 - y0) / length))


def estimated_axis(table: pd.DataFrame, where: str) -> Axis:
    """The axis of the paths of a table with `path` (a name), `x_m` and `y_m`, in the direction of most vehicles.

    Errors: `InputError` if no vehicle travels.
    """
    travelled = _displacements(table)
    if not (travelled.abs() >= LEAST_PATH).any():
        raise InputError(
            f"{where}: no vehicle travels {LEAST_PATH:g} m, so the direction of the road is not known; give"
            " --axis X0 Y0 X1 Y1"
        )
    doubled = np.angle((travelled**2).sum()) / 2  # opposite directions are one axis
    unit = np.exp(1j * doubled)
    if (np.sign((travelled * unit.conj()).to_numpy().real)).sum() < 0:
        unit = -unit
    origin = float(table["x_m"].iloc[0]), float(table["y_m"].iloc[0])
    rough = Axis(origin, (float(unit.real), float(unit.imag)))
    chosen = table.iloc[:: max(1, len(table) // SAMPLES)]
    u, v = rough.to_road(chosen["x_m"].to_numpy(), chosen["y_m"].to_numpy())
    ends = float(u.min()), float(u.max())
    bend = _refined(_common_shape(chosen["path"], u, v, DEGREE), chosen["path"], u, v, ends)
    inside = np.linspace(*ends, 50)
    chord = np.polyval(np.polyfit(inside, np.polyval(bend, inside), 1), inside)
    if np.abs(np.polyval(bend, inside) - chord).max() > STRAIGHT:
        return Axis(origin, rough.direction, tuple(bend), *ends)
    turned = np.exp(1j * np.arctan(_common_shape(chosen["path"], u, v, 1)[0])) * unit
    start = complex(*origin) + ends[0] * turned
    return Axis((float(start.real), float(start.imag)), (float(turned.real), float(turned.imag)))


def _displacements(table: pd.DataFrame) -> pd.Series:
    """From the first to the last position of each vehicle, as complex numbers [m]."""
    ends = table.groupby("path", sort=False)[["x_m", "y_m"]].agg(["first", "last"])
    along, aside = (ends[name, "last"] - ends[name, "first"] for name in ("x_m", "y_m"))
    return along + 1j * aside


def _common_shape(vehicle: pd.Series, u: np.ndarray, v: np.ndarray, degree: int) -> np.ndarray:
    """Coefficients of the polynomial, without constant, that all paths share; each path has an offset of its own."""
    scale = max(float(np.abs(u).max()), 1.0)
    powers = np.stack([(u / scale) ** k for k in range(degree, 0, -1)], 1)
    frame = pd.DataFrame(np.column_stack([powers, v]))
    within = (frame - frame.groupby(vehicle.to_numpy()).transform("mean")).to_numpy()
    fitted = np.linalg.lstsq(within[:, :-1], within[:, -1], rcond=1e-8)[0]
    return np.r_[fitted / scale ** np.arange(degree, 0, -1), 0.0]


def _refined(
    bend: np.ndarray, vehicle: pd.Series, u: np.ndarray, v: np.ndarray, ends: tuple[float, float]
) -> np.ndarray:
    """The polynomial through all paths after each is moved at right angles by its mean distance from the curve.

    At first, paths were moved along v only, which is right where the axis is straight.
    """
    for _ in range(3):
        axis = Axis((0.0, 0.0), (1.0, 0.0), tuple(bend), *ends)
        d = pd.Series(axis.to_road(u, v)[1]).groupby(vehicle.to_numpy()).transform("mean").to_numpy()
        slope = np.polyval(np.polyder(bend), u)
        size = np.sqrt(1 + slope**2)
        bend = np.polyfit(u + d * slope / size, v - d / size, DEGREE)
    return bend


def on_roads(table: pd.DataFrame, axis: Axis, notes: list[str]) -> Iterator[tuple[str, pd.DataFrame]]:
    """The table with `s_m` and `d_m`, separated by direction: ("", along the axis), ("against", against it).

    s_m counts from the beginning of the axis, or from the rearmost vehicle's position if the axis was estimated.
    Vehicles that drive across the road are left out, and `notes` says how many.
    """
    s, d = axis.to_road(table["x_m"].to_numpy(), table["y_m"].to_numpy())
    placed = table.assign(s_m=s, d_m=d)
    path = placed.groupby("path", sort=False)[["s_m", "d_m"]].agg(["first", "last"])
    along, aside = (path[name, "last"] - path[name, "first"] for name in ("s_m", "d_m"))
    angle = np.degrees(np.arctan2(aside.abs(), along.abs()))
    moving = np.hypot(along, aside) >= LEAST_PATH
    way = pd.Series(np.sign(along), along.index).where(moving, 0.0)
    if "heading_rad" in placed:
        turned = placed["heading_rad"] - np.arctan2(axis.direction[1], axis.direction[0])
        facing = np.sign(np.cos(turned).groupby(placed["path"], sort=False).mean())
        way = way.where(moving, facing.reindex(way.index).fillna(0.0))
    way = way.where(way != 0, np.sign(along.sum()) or 1.0)
    across = moving & (angle > ACROSS)
    if across.any():
        notes.append(f"{int(across.sum())} vehicles that drive across the road are left out")
    sides = placed["path"].map(way.where(~across))
    for suffix, sign in (("", 1.0), ("against", -1.0)):
        part = placed[sides == sign]
        if not len(part):
            continue
        if sign < 0:
            part = part.assign(s_m=placed["s_m"].max() - part["s_m"], d_m=-part["d_m"])
        yield suffix, part
