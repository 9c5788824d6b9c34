"""The inner loops of some functions of numpy, as addresses that compiled code can call.

A policy driven by compiled code is to give the same bits as in Python. Products and curves depend on the library and
on the processor, so compiled code calls the very loops that numpy has chosen here. The layout is that of numpy's public
`PyUFuncObject`; what is found is tried before it is used.
"""

import ctypes
from functools import lru_cache

import numpy as np

_HEAD = object.__basicsize__
_FLOAT, _DOUBLE = 11, 12  # numpy's numbers of its types
WANTED = (
    (np.matmul, _FLOAT),
    (np.matmul, _DOUBLE),
    (np.tanh, _FLOAT),
    (np.cos, _DOUBLE),
    (np.sin, _DOUBLE),
    (np.sin, _FLOAT),
)


class _UFunc(ctypes.Structure):
    _fields_ = (
        ("nin", ctypes.c_int),
        ("nout", ctypes.c_int),
        ("nargs", ctypes.c_int),
        ("identity", ctypes.c_int),
        ("functions", ctypes.POINTER(ctypes.c_void_p)),
        ("data", ctypes.POINTER(ctypes.c_void_p)),
        ("ntypes", ctypes.c_int),
        ("reserved", ctypes.c_int),
        ("name", ctypes.c_char_p),
        ("types", ctypes.POINTER(ctypes.c_char)),
    )


_LOOP = ctypes.CFUNCTYPE(
    None,
    ctypes.POINTER(ctypes.c_void_p),
    ctypes.POINTER(ctypes.c_ssize_t),
    ctypes.POINTER(ctypes.c_ssize_t),
    ctypes.c_void_p,
)


@lru_cache(maxsize=1)
def loops() -> tuple[int | None, ...] | None:
    """Addresses of the loops of `WANTED`, each with its data.

    None where this version of numpy is laid out otherwise.
    """
    found = [_loop(function, kind) for function, kind in WANTED]
    if any(loop is None or not _gives_the_same(*of, *loop) for of, loop in zip(WANTED, found, strict=True)):
        return None
    return tuple(address for loop in found if loop is not None for address in loop)


def _loop(function: np.ufunc, kind: int) -> tuple[int, int | None] | None:
    """The inner loop for one type of all arguments, and its data."""
    of = _UFunc.from_address(id(function) + _HEAD)
    if (of.nin, of.nout, of.name) != (function.nin, function.nout, function.__name__.encode()):
        return None
    for k in range(of.ntypes):
        if of.types[k * of.nargs : (k + 1) * of.nargs] == bytes([kind]) * of.nargs and of.functions[k]:
            return of.functions[k], of.data[k] if of.data else None
    return None


def _gives_the_same(function: np.ufunc, kind: int, address: int, data: int | None) -> bool:
    """Whether the loop gives what the function of numpy gives."""
    rng, dtype = np.random.default_rng(0), np.float32 if kind == _FLOAT else np.float64
    if function.nin == 1:
        x = rng.normal(size=301).astype(dtype)
        result, arguments, sizes, steps = np.empty_like(x), (x,), (len(x),), (x.itemsize, x.itemsize)
    else:
        x, y = rng.normal(size=(30, 7)).astype(dtype), rng.normal(size=(65, 7)).astype(dtype).T
        result, arguments, sizes = np.empty((30, 65), dtype), (x, y), (1, 30, 7, 65)
        steps = (0, 0, 0, *x.strides, *y.strides, *result.strides)
    pointers = (ctypes.c_void_p * function.nargs)(*(of.ctypes.data for of in (*arguments, result)))
    _LOOP(address)(pointers, (ctypes.c_ssize_t * len(sizes))(*sizes), (ctypes.c_ssize_t * len(steps))(*steps), data)
    return bool(np.array_equal(result, function(*arguments)))
