"""The compiled core as a library: its structures and functions, as `step_core.cpp` has them."""

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np

from cosim.core.build import core_status

QUIET, JUDGE, DECIDE, REFUSED, FAILED = 0, 1, 2, 3, -1
_ADDRESS, _INTEGER = ctypes.c_void_p, ctypes.c_int64
ShadowCall = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, ctypes.c_int)
StepCall = ctypes.CFUNCTYPE(ctypes.c_int)


class Array(ctypes.Structure):
    """A matrix of numpy."""

    _fields_ = (("data", _ADDRESS), *((name, _INTEGER) for name in ("rows", "columns", "row_step", "column_step")))

    @classmethod
    def of(cls, matrix: np.ndarray) -> "Array":
        """The matrix, which must be kept."""
        return cls(matrix.ctypes.data, *matrix.shape, *matrix.strides)


class RoundFields(ctypes.Structure):
    """What does not change in a round."""

    _fields_ = (
        ("dt", ctypes.c_double),
        ("settle", ctypes.c_double),
        ("road", ctypes.c_double * 10),
        *((name, _INTEGER) for name in ("groups", "size", "features", "every", "side", "records", "merge")),
        *((name, _INTEGER) for name in ("has_third", "join")),
        *((name, _ADDRESS) for name in ("offset", "across", "width", "strips")),
        ("pairs", _INTEGER),
        ("pair_ends", _ADDRESS),
        ("loops", _ADDRESS * 12),
        ("matrix", Array),
        *((name, _ADDRESS) for name in ("state", "commanded", "pose", "before", "action", "active", "shadowed")),
        *((name, _ADDRESS) for name in ("driven", "inside")),
        ("shadow_call", ShadowCall),
        ("step_call", StepCall),
    )


class PolicyFields(ctypes.Structure):
    """A feed-forward policy under one graph."""

    _fields_ = (
        *((name, _INTEGER) for name in ("driven", "pairs", "end_sender", "end_receiver", "actions", "turns", "inner")),
        *((name, Array) for name in ("read", "edge", "node", "last")),
        ("inner_weights", ctypes.POINTER(Array)),
        *((name, _ADDRESS) for name in ("read_bias", "edge_bias", "last_bias", "unit", "mask")),
        ("inner_biases", ctypes.POINTER(_ADDRESS)),
        *((name, _ADDRESS) for name in ("senders", "receivers", "driven_rows", "turn_ends", "turn_receivers")),
    )


class Records(ctypes.Structure):
    """Where the steps of a call are recorded."""

    _fields_ = (
        *((name, _INTEGER) for name in ("steps", "decisions", "lists")),
        *((name, _ADDRESS) for name in ("times", "blocks", "sizes", "observations", "poses", "states")),
        *((name, _ADDRESS) for name in ("counts", "near_counts", "versions", "near_versions", "near_rows")),
        *((name, _ADDRESS) for name in ("rows", "valid")),
        *((name, _INTEGER) for name in ("block_length", "size_length", "observation_length", "pose_length")),
        *((name, _INTEGER) for name in ("state_length", "near_length")),
        ("speeds", _ADDRESS),
        ("speed_length", _INTEGER),
    )


@lru_cache(maxsize=1)
def library() -> Any:
    """The compiled core, loaded; None where Python is to drive."""
    path = core_status().library
    if path is None:
        return None
    core = ctypes.CDLL(str(path))  # never with RTLD_GLOBAL: torch would find SUMO's libraries instead of its own
    core.core_new.restype = _ADDRESS
    core.core_new.argtypes = ctypes.POINTER(RoundFields), *[ctypes.c_char_p] * 3
    core.core_delete.argtypes = (_ADDRESS,)
    core.core_start.argtypes = _ADDRESS, ctypes.c_double, ctypes.c_char_p, _ADDRESS, ctypes.c_char_p
    core.core_policy.argtypes = _ADDRESS, ctypes.POINTER(PolicyFields), ctypes.c_int
    core.core_members.argtypes = _ADDRESS, ctypes.c_char_p, _ADDRESS
    core.core_ahead.argtypes = _ADDRESS, ctypes.c_char_p, _INTEGER, _ADDRESS
    core.core_taken.argtypes = _ADDRESS, ctypes.c_char_p
    core.core_watch.argtypes = _ADDRESS, ctypes.c_char_p
    core.core_advance.argtypes = _ADDRESS, _INTEGER, _INTEGER, *[ctypes.c_int] * 4
    core.core_records.argtypes = _ADDRESS, ctypes.POINTER(Records)
    for name in ("core_message", "core_list", "core_lanes"):
        getattr(core, name).restype = ctypes.c_char_p
        getattr(core, name).argtypes = (_ADDRESS, _INTEGER) if name == "core_list" else (_ADDRESS,)
    return core
