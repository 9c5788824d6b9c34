"""Checks the types and shapes of the first calls of every function in every test.

jaxtyping's import hook has every annotated function of `gri` and `cosim` checked by beartype. A simulation calls some
of them thousands of times with the same shapes. Checked each time, the tests take two to four times as long.
"""

import functools
import inspect
from collections import Counter
from collections.abc import Callable
from typing import Any

import jaxtyping

CHECKED = 50  # calls of a function in one test
_calls: Counter[str] = Counter()
_jaxtyped = jaxtyping.jaxtyped


def start_over() -> None:
    """Count from nought again: what one test checks does not depend on the tests before it."""
    _calls.clear()


def first_calls(of: Any, *, typechecker: Any) -> Any:
    """`jaxtyping.jaxtyped` of a function or class, whose checks end when it was called often enough."""
    if inspect.isclass(of):
        plain = of.__init__
        checked = _jaxtyped(of, typechecker=typechecker)
        if checked.__init__ is not plain:
            checked.__init__ = _while_new(plain, lambda init=checked.__init__: init)
        return checked
    return _while_new(of, lambda: _jaxtyped(of, typechecker=typechecker))


def _while_new(plain: Callable[..., Any], make_checked: Callable[[], Callable[..., Any]]) -> Callable[..., Any]:
    """The function; its first calls go through the checked form.

    That of a function inside another is made when it is called, as it is defined anew again and again; that of others
    at once, so that copies of this process have it.
    """
    name = f"{plain.__module__}.{plain.__qualname__}"
    checked = None if "<locals>" in plain.__qualname__ else make_checked()

    @functools.wraps(plain)
    def call(*arguments: Any, **named: Any) -> Any:
        __tracebackhide__ = True
        nonlocal checked
        if _calls[name] >= CHECKED:
            return plain(*arguments, **named)
        _calls[name] += 1
        checked = checked or make_checked()
        return checked(*arguments, **named)

    return call


def install() -> None:
    """Have the import hook use `first_calls`; it looks `jaxtyping.jaxtyped` up wherever it decorates."""
    jaxtyping.jaxtyped = lambda of=None, **options: (
        functools.partial(first_calls, **options) if of is None else first_calls(of, **options)
    )
