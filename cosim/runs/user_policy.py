"""Policies that people write: a Python file with a class or function that makes one."""

import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from cosim.spec.input_files import source_path
from cosim.spec.scenario import UserPolicy
from gri.errors import InputError

WANTED = ("dynamics", "dt", "history_steps", "begin", "act")  # of gri.core.policy.Policy


def own_policy(choice: UserPolicy, dt: float) -> Any:
    """Make the policy that acts every `dt` [s]; an InputError says what its file lacks or why it failed."""
    place, _, name = choice.object.rpartition(":")
    path = source_path(choice)
    module = _loaded(path) if place.endswith(".py") else import_module(place)
    make: Callable[..., Any] | None = getattr(module, name, None)
    if not callable(make):
        raise InputError(f"policy.object: {place} has no class or function {name!r}; define one")
    try:
        policy = make(dt=dt, **choice.settings)
    except Exception as error:
        raise InputError(f"policy.object: {name}(dt={dt:g}, ...) failed: {type(error).__name__}: {error}") from error
    if missing := missing_attributes(policy):
        raise InputError(
            f"policy.object: {name} made something without {', '.join(missing)}; see gri.core.policy.Policy"
        )
    return policy


def missing_attributes(policy: object) -> list[str]:
    """Attributes of `gri.core.policy.Policy` that an object lacks."""
    return [attribute for attribute in WANTED if not hasattr(policy, attribute)]


def _loaded(path: Path) -> ModuleType:
    """The module of a file, under a name of its own; modules beside it can be imported by it."""
    spec = spec_from_file_location(f"own_policy_{path.stem}", path)
    assert spec is not None, path
    assert spec.loader is not None, path
    module = module_from_spec(spec)
    sys.modules[module.__name__] = module  # dataclasses look their module up
    if str(path.resolve().parent) not in sys.path:
        sys.path.append(str(path.resolve().parent))
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise InputError(f"{path}: cannot be imported: {type(error).__name__}: {error}") from error
    return module
