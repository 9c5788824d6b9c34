"""The few functions that a policy and its dynamics are made of, for torch and for numpy.

Formulas are written once with these. Torch learns with them; numpy drives a few groups one step on, where calling
torch costs several times what it computes.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple, ParamSpec, TypeVar, cast

import numpy as np
import torch
from torch import Tensor

P = ParamSpec("P")
R = TypeVar("R")


class Arrays(NamedTuple):
    """One library's functions, which take and return its arrays."""

    linear: Callable[..., Any]
    """(x, weight [O, I], bias [O] or None) -> x·weightᵀ + bias."""
    add_product: Callable[[Any, Any, Any], Any]
    """(sum [R, O], x [R, I], weight [I, O]) -> sum + x·weight."""
    silu: Callable[[Any], Any]
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


TORCH = Arrays(
    linear=torch.nn.functional.linear,
    add_product=torch.addmm,
    silu=torch.nn.functional.silu,
    join=lambda x: torch.cat(x, -1),
    cos=torch.cos,
    sin=torch.sin,
)
NUMPY = Arrays(
    linear=_linear,
    add_product=lambda total, x, weight: total + x @ weight,
    silu=_silu,
    join=lambda x: np.concatenate(x, -1),
    cos=np.cos,
    sin=np.sin,
)


def arrays_of(value: Tensor | np.ndarray) -> Arrays:
    """The functions for a value's library."""
    return NUMPY if isinstance(value, np.ndarray) else TORCH


def kept(make: Callable[P, R]) -> Callable[P, R]:
    """Keep the tensors that a function makes; they serve training also where a drive in inference mode asked first."""
    return cast(Callable[P, R], lru_cache(torch.inference_mode(False)(make)))
