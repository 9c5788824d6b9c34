"""Wrong types and shapes are refused in every test anew, and only a function's first calls pay for it."""

from dataclasses import dataclass

import jaxtyping
import pytest
import torch
from beartype import beartype
from jaxtyping import Float
from torch import Tensor

from gri.core.dynamics import POINT_MASS_1D
from tests import shape_checks

CHECKED = jaxtyping.jaxtyped(typechecker=beartype)


@CHECKED
def added(a: Float[Tensor, "n 2"], b: Float[Tensor, "n 2"]) -> Float[Tensor, "n 2"]:
    return a + b


@CHECKED
@dataclass(frozen=True)
class Place:
    at: Float[Tensor, "2"]


def assert_refused() -> None:
    with pytest.raises(jaxtyping.TypeCheckError, match="added"):
        added(torch.zeros(3, 2), torch.zeros(1, 2))
    with pytest.raises(jaxtyping.TypeCheckError, match="Place"):
        Place(torch.zeros(3))


def test_shapes_that_do_not_fit_are_refused_until_a_function_was_called_often():
    assert_refused()
    for _ in range(shape_checks.CHECKED):
        added(torch.zeros(3, 2), torch.zeros(3, 2))
        Place(torch.zeros(2))
    added(torch.zeros(3, 2), torch.zeros(1, 2))
    Place(torch.zeros(3))
    shape_checks.start_over()
    assert_refused()


@pytest.mark.parametrize("again", [1, 2])
def test_every_test_checks(again: int):
    assert_refused()
    for _ in range(2 * shape_checks.CHECKED):
        added(torch.zeros(3, 2), torch.zeros(3, 2))


def test_the_packages_are_checked():
    with pytest.raises(jaxtyping.TypeCheckError, match="step"):
        POINT_MASS_1D.step(torch.zeros(3, 7), torch.zeros(2, 1), 0.2)
