"""Grounded Relational Inference: graphs of relations between vehicles, and policies that obey them."""

from gri.checkpoint import load, save
from gri.errors import InputError
from gri.graph import EdgeType, InteractionGraph
from gri.model import ModelConfig, RelationalModel
from gri.policy import ConstantVelocity, IntelligentDriver, Policy, PolicyState
from gri.types import Trajectory

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
