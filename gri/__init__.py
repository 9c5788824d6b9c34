"""Grounded Relational Inference: graphs of relations between vehicles, and policies that drive under them.

Begin with `load`, which reads a released model (`checkpoints` lists their names). `evaluate` scores a model on
`Scenes`, and `rollout` drives with it. `Policy` lists the members that a policy of your own needs; docs/tutorial.md
writes one. Names are imported when they are first used, so that `import gri` does not wait for torch.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gri.checkpoint import load, save
    from gri.core.dynamics import DUBINS, POINT_MASS_1D, Dynamics
    from gri.core.graph import EdgeType, InteractionGraph, pairs
    from gri.core.merging_policy import MergingDriver
    from gri.core.policy import ConstantVelocity, IntelligentDriver, Policy, PolicyState
    from gri.core.scenes import Scenes
    from gri.core.trajectory import Trajectory
    from gri.errors import InputError
    from gri.evaluation.evaluate import Evaluation, evaluate
    from gri.networks.model import ModelConfig, RelationalModel
    from gri.networks.rollout import Rollout, rollout
    from gri.resources import checkpoints

__all__ = [
    "DUBINS",
    "POINT_MASS_1D",
    "ConstantVelocity",
    "Dynamics",
    "EdgeType",
    "Evaluation",
    "InputError",
    "IntelligentDriver",
    "InteractionGraph",
    "MergingDriver",
    "ModelConfig",
    "Policy",
    "PolicyState",
    "RelationalModel",
    "Rollout",
    "Scenes",
    "Trajectory",
    "checkpoints",
    "evaluate",
    "load",
    "pairs",
    "rollout",
    "save",
]
__version__ = version("gri-cosim")

_HOMES = {
    "gri.checkpoint": ("load", "save"),
    "gri.core.dynamics": ("DUBINS", "POINT_MASS_1D", "Dynamics"),
    "gri.core.graph": ("EdgeType", "InteractionGraph", "pairs"),
    "gri.core.merging_policy": ("MergingDriver",),
    "gri.core.policy": ("ConstantVelocity", "IntelligentDriver", "Policy", "PolicyState"),
    "gri.core.scenes": ("Scenes",),
    "gri.core.trajectory": ("Trajectory",),
    "gri.errors": ("InputError",),
    "gri.evaluation.evaluate": ("Evaluation", "evaluate"),
    "gri.networks.model": ("ModelConfig", "RelationalModel"),
    "gri.networks.rollout": ("Rollout", "rollout"),
    "gri.resources": ("checkpoints",),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
