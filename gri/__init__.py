"""Grounded Relational Inference: graphs of relations between vehicles, and policies that obey them.

Names are imported when they are first used: commands that need no model do not wait for torch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gri.checkpoint import load, save
    from gri.core.graph import EdgeType, InteractionGraph
    from gri.core.policy import ConstantVelocity, IntelligentDriver, Policy, PolicyState
    from gri.core.trajectory import Trajectory
    from gri.errors import InputError
    from gri.networks.model import ModelConfig, RelationalModel

__all__ = [
    "ConstantVelocity",
    "EdgeType",
    "InputError",
    "IntelligentDriver",
    "InteractionGraph",
    "ModelConfig",
    "Policy",
    "PolicyState",
    "RelationalModel",
    "Trajectory",
    "load",
    "save",
]

_HOMES = {
    "gri.checkpoint": ("load", "save"),
    "gri.errors": ("InputError",),
    "gri.core.graph": ("EdgeType", "InteractionGraph"),
    "gri.networks.model": ("ModelConfig", "RelationalModel"),
    "gri.core.policy": ("ConstantVelocity", "IntelligentDriver", "Policy", "PolicyState"),
    "gri.core.trajectory": ("Trajectory",),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
