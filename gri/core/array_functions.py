"""The functions that a policy and its dynamics are made of, for torch and for numpy.

Formulas are written once with these functions. Torch is for training. Numpy drives a few groups one step on, where a
call of torch takes several times as long as the computation in it.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple, ParamSpec, TypeVar, cast

import numpy as np
import torch
from torch import Tensor

P = ParamSpec("P")
R = TypeVar("R")


class ArrayFunctions(NamedTuple):
    """The functions of one library, which take and return its arrays."""

    linear: Callable[..., Any]
    """(x [..., I], weight [O, I], bias [O] or None) -> x·weightᵀ + bias."""
    silu: Callable[[Any], Any]
    """x·σ(x), element by element."""
    join: Callable[[Any], Any]
    """Concatenate along the last axis."""
    cos: Callable[[Any], Any]
    sin: Callable[[Any], Any]


def _linear(x: np.ndarray, weight: np.ndarray, bias: np.ndarray | None = None) -> np.ndarray:
    product = x.reshape(-1, x.shape[-1]) @ weight.T  # one product, not one for each scene
    if bias is not None:
        product += bias
    return product.reshape(*x.shape[:-1], -1)


def _silu(x: np.ndarray) -> np.ndarray:
    """x·σ(x), with σ(x) = (1 + tanh(x/2))/2, which never overflows."""
    half = 0.5 * x
    return half + half * np.tanh(half)


TORCH = ArrayFunctions(
    linear=torch.nn.functional.linear,
    silu=torch.nn.functional.silu,
    join=lambda x: torch.cat(x, -1),
    cos=torch.cos,
    sin=torch.sin,
)
NUMPY = ArrayFunctions(
    linear=_linear,
    silu=_silu,
    join=lambda x: np.concatenate(x, -1),
    cos=np.cos,
    sin=np.sin,
)


def functions_for(value: Tensor | np.ndarray) -> ArrayFunctions:
    """The functions of the library that a value belongs to."""
    return NUMPY if isinstance(value, np.ndarray) else TORCH


def cache_tensors(make: Callable[P, R]) -> Callable[P, R]:
    """Cache the tensors that a function makes, one result per set of arguments.

    The tensors are made outside torch's inference mode, so that training can use them as well.
    """
    return cast(Callable[P, R], lru_cache(torch.inference_mode(False)(make)))
