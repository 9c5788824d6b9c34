"""Polylines of shape (M, 2): corners, normals at the vertices, lengths."""

import itertools

import numpy as np
from jaxtyping import Float

CORNER_REACH = 5.0  # [m] before and after a corner, within which the normals turn
WIDEST_ROAD = 15.0  # [m] beside the line, up to which the normals of neighbouring vertices should not cross
STRAIGHT = 1e-12  # sine of a turn that is none


def without_straight_vertices(line: Float[np.ndarray, "M 2"]) -> Float[np.ndarray, "K 2"]:
    """The same polyline without the vertices at which it does not turn, so that projections cost less."""
    direction = directions(line)
    turn = direction[:-1, 0] * direction[1:, 1] - direction[:-1, 1] * direction[1:, 0]
    return line[np.concatenate([[True], np.abs(turn) > STRAIGHT, [True]])]


def directions(line: Float[np.ndarray, "M 2"]) -> Float[np.ndarray, "S 2"]:
    """The unit vector along each segment."""
    direction = np.diff(line, axis=0)
    return direction / np.hypot(direction[:, 0], direction[:, 1])[:, None]


def length_of(line: Float[np.ndarray, "M 2"]) -> float:
    """The length [m] of a polyline."""
    step = np.diff(line, axis=0)
    return float(np.hypot(step[:, 0], step[:, 1]).sum())


def without_repeated_points(line: Float[np.ndarray, "M 2"], apart: float = 1e-3) -> Float[np.ndarray, "K 2"]:
    """The polyline without vertices that are nearer than `apart` [m] to the one before; two are left at least."""
    kept = [line[0]]
    for point in line[1:]:
        if np.hypot(*(point - kept[-1])) >= apart:
            kept.append(point)
    return np.array(kept if len(kept) > 1 else [line[0], line[0] + [apart, 0.0]])


def with_corner_vertices(line: Float[np.ndarray, "M 2"]) -> Float[np.ndarray, "K 2"]:
    """The same polyline with more vertices near its corners, so that normals turn there and not along a whole side."""
    direction = directions(line)
    cosine = np.clip((direction[:-1] * direction[1:]).sum(axis=1), -1, 1)
    half = np.tan(0.5 * np.arccos(np.minimum(cosine, 1 - STRAIGHT)))
    reach = np.maximum(CORNER_REACH, WIDEST_ROAD * half)
    turns = np.abs(direction[:-1, 0] * direction[1:, 1] - direction[:-1, 1] * direction[1:, 0]) > STRAIGHT
    reach = np.concatenate([[0.0], np.where(turns, reach, 0.0), [0.0]])
    points = [line[0]]
    for k, (begin, end) in enumerate(itertools.pairwise(line)):
        length = float(np.hypot(*(end - begin)))
        before, after = reach[k], reach[k + 1]
        points += [begin + direction[k] * before] if 0 < before < 0.5 * length else []
        points += [end - direction[k] * after] if 0 < after < 0.5 * length else []
        points.append(end)
    return np.array(points)


def corner_normals(line: Float[np.ndarray, "M 2"]) -> Float[np.ndarray, "M 2"]:
    """The normal to the left at each vertex; at a corner the bisector, as long as parallel lines need it."""
    direction = directions(line)
    left = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    both = left[:-1] + left[1:]
    scale = 1 + (left[:-1] * left[1:]).sum(axis=1)  # twice the squared cosine of half the turn
    return np.concatenate([left[:1], both / np.maximum(scale, 0.5)[:, None], left[-1:]])


def turned_normals(
    first: Float[np.ndarray, " 2"], last: Float[np.ndarray, " 2"], share: Float[np.ndarray, " K"]
) -> Float[np.ndarray, "K 2"]:
    """Unit normals that turn evenly from the first to the last, the shorter way."""
    begin = np.arctan2(first[1], first[0])
    turn = (np.arctan2(last[1], last[0]) - begin + np.pi) % (2 * np.pi) - np.pi
    return np.stack([np.cos(begin + share * turn), np.sin(begin + share * turn)], axis=1)
