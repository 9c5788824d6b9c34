"""Policies that people write: a Python file with a class or function that makes one."""

import math
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from cosim.spec.input_files import source_path
from cosim.spec.scenario import UserPolicy
from cosim.world.episode import LEFT_ALONE
from gri.errors import InputError

WANTED = ("dynamics", "dt", "history_steps", "begin", "act")  # of gri.core.policy.Policy


def own_policy(choice: UserPolicy, dt: float) -> Any:
    """Make the policy that acts every `dt` [s]; an InputError says what its file lacks or why it failed."""
    place, _, name = choice.object.rpartition(":")
    path = source_path(choice)
    module = _loaded(path) if place.endswith(".py") else _imported(place)
    make: Callable[..., Any] | None = getattr(module, name, None)
    if not callable(make):
        raise InputError(f"policy.object: {place} has no class or function {name!r}; define one")
    try:
        policy = make(dt=dt, **choice.settings)
    except (Exception, SystemExit) as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"policy.object: {name}(dt={dt:g}, ...) failed: {said}; correct it") from error
    if problem := unfit(policy):
        raise InputError(f"policy.object: {name} made {problem}; see gri.Policy")
    return policy


def unfit(policy: object) -> str:
    """What is wrong with the attributes of an object that should be a `gri.core.policy.Policy`; empty if nothing is."""
    from gri.core.dynamics import Dynamics  # imports torch

    if missing := [attribute for attribute in WANTED if not hasattr(policy, attribute)]:
        return f"a {type(policy).__name__} without {', '.join(missing)}"
    for attribute, right, wanted in (
        ("dynamics", lambda value: isinstance(value, Dynamics), "a gri.Dynamics"),
        ("dt", lambda value: isinstance(value, int | float) and 0 < value < math.inf, "a time [s] above 0"),
        ("history_steps", lambda value: isinstance(value, int) and value >= 1, "a number of steps of at least 1"),
        ("begin", callable, "a method"),
        ("act", callable, "a method"),
    ):
        value = getattr(policy, attribute)
        if not right(value):
            return f"a {type(policy).__name__} whose {attribute} is {_shown(value)}, expected {wanted}"
    return ""


def _shown(value: object) -> str:
    return f"{value}" if type(value) in (int, float) else f"a {type(value).__name__}"


def _imported(name: str) -> ModuleType:
    try:
        return import_module(name)
    except (Exception, SystemExit) as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"policy.object: {name} cannot be imported: {said}; correct it") from error


def own_name(policy: object) -> str:
    """The name of a policy in tables, pictures and file names: its attribute `name` if that is a text, else its class.

    Raises:
        InputError: the name is that of a driver of counterparts, with which the policy would be confused.
    """
    name = getattr(policy, "name", None)
    name = name if isinstance(name, str) and name else type(policy).__name__
    if name in LEFT_ALONE:
        raise InputError(f"policy: got the name {name!r}, which means that no policy drives; give it another `name`")
    return name


def _loaded(path: Path) -> ModuleType:
    """The module of a file, under a name of its own; modules beside it can be imported by it."""
    spec = spec_from_file_location(f"own_policy_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: cannot be imported; give the path of a Python file")
    module = module_from_spec(spec)
    sys.modules[module.__name__] = module  # dataclasses look their module up
    if str(path.resolve().parent) not in sys.path:
        sys.path.append(str(path.resolve().parent))
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"{path}: cannot be imported: {said}; correct it") from error
    return module
