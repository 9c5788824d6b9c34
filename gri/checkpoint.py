"""Models as files: safetensors with one typed header. Nothing in them is code.

Functions that read take the path of a file or the name of a released checkpoint, such as "us101_merge". They raise
`InputError` if there is no such file, if it is damaged, or if it does not fit this release
(docs/decisions/004-checkpoints.md).
"""

import hashlib
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import torch
from safetensors import safe_open
from safetensors.torch import save as packed
from torch import Tensor

from gri.core.graph import FOLLOWING
from gri.errors import InputError, guarded_reading
from gri.networks.model import ModelConfig, RelationalModel
from gri.resources import find_checkpoint
from gri.rewards.structured import AssumedReward, LaneRewardConfig, NaturalisticConfig, RewardConfig, StructuredReward
from gri.storage.checkpoint_header import FORMAT, REMAKE, VERSION, Header, damaged, header_of, refuse_old_format, typed
from gri.storage.whole_files import write_whole

_MODEL, _REWARD = "model.", "reward."  # what the names of tensors begin with


def save(
    path: Path | str,
    model: RelationalModel,
    reward: StructuredReward | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Write a model, the reward it was grounded in, and how both were made (any values that JSON can hold).

    The file appears whole or not at all; its folder is made if it is missing. Equal contents give equal bytes.
    """
    config, dynamics = model.config, model.dynamics
    tensors = _tensors(model, _MODEL) | (_tensors(reward, _REWARD) if reward else {})
    header = Header(
        version=VERSION,
        sha256=tensor_digest(tensors),
        config=msgspec.to_builtins(config),
        dt=config.dt,
        history_steps=config.history_steps,
        vocabulary=[str(k) for k in config.vocabulary],
        state=list(dynamics.state),
        action=list(dynamics.action),
        reward_config=msgspec.to_builtins(reward.config) if reward else None,
        provenance=msgspec.to_builtins(dict(provenance or {})),
    )
    write_whole(Path(path), packed(tensors, {FORMAT: msgspec.json.encode(header).decode()}))


def _tensors(module: torch.nn.Module, prefix: str) -> dict[str, Tensor]:
    return {prefix + name: tensor.detach().clone().contiguous() for name, tensor in module.state_dict().items()}


def tensor_digest(tensors: Mapping[str, Tensor], text: str = "") -> str:
    """SHA-256 of tensors with their names, types and shapes, and of a text."""
    total = hashlib.sha256(text.encode())
    for name, tensor in sorted(tensors.items()):
        total.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        total.update(tensor.numpy().tobytes())
    return total.hexdigest()


def load(path: Path | str) -> RelationalModel:
    """The model of a checkpoint, with fixed weights and ready to drive.

    `path` is a file, or the name of a released checkpoint (`gri.checkpoints()` lists them). The model is a
    `gri.Policy`: `begin` infers the graph from a history, `act` gives the actions of the next step (SI units).

    Raises:
        InputError: there is no such checkpoint, it is damaged, or it does not fit this release.

    Example:
        >>> import gri
        >>> model = gri.load("us101_car_following")
        >>> model.dynamics.state, model.dt, model.history_steps
        >>> model.infer(state)  # the graph; `state` is [groups, vehicles, instants, features]
    """
    header, tensors = _read(path)
    with guarded_reading(path, "checkpoint", REMAKE):
        config = typed(header.config, ModelConfig, path)
        _check_shapes(lambda: RelationalModel(config), tensors[_MODEL], path)
        model = RelationalModel(config)
        _check_layout(header, model, path)
        model.load_state_dict(tensors[_MODEL])
        return model.requires_grad_(False).eval()


def load_reward(path: Path | str) -> StructuredReward | None:
    """The reward that the model of a checkpoint was grounded in, with fixed weights; None if it has none."""
    header, tensors = _read(path)
    if header.reward_config is None:
        return None
    with guarded_reading(path, "checkpoint", REMAKE):
        kind = RewardConfig if tuple(header.vocabulary) == FOLLOWING else LaneRewardConfig
        if "type" in header.reward_config:
            kind = NaturalisticConfig | AssumedReward
        config = typed(header.reward_config, kind, path)
        _check_shapes(lambda: StructuredReward(config), tensors[_REWARD], path)
        reward = StructuredReward(config)
        reward.load_state_dict(tensors[_REWARD])
        return reward.requires_grad_(False).eval()


def provenance(path: Path | str) -> dict[str, Any]:
    """How a checkpoint was made: configuration, seed, versions and scores."""
    return _read(path)[0].provenance


def objective(path: Path | str) -> str:
    """The objective that a model was trained with: "gri", "nri", "supervised", …; "gri" if the file does not say."""
    return _read(path)[0].objective


def _read(path: Path | str) -> tuple[Header, dict[str, dict[str, Tensor]]]:
    """The header of a checkpoint, and its tensors by what they belong to (`_MODEL`, `_REWARD`) and name."""
    path = find_checkpoint(path)
    tensors: dict[str, dict[str, Tensor]] = {_MODEL: {}, _REWARD: {}}
    with guarded_reading(path, "checkpoint", REMAKE):
        refuse_old_format(path)
        with safe_open(path, "pt") as file:
            header = header_of(file.metadata(), path)
            found = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (it is no mapping)
    for name, tensor in found.items():
        prefix = next((prefix for prefix in tensors if name.startswith(prefix)), None)
        if prefix is None or not torch.isfinite(tensor).all():
            raise InputError(f"{path}: its tensor {name[:60]} is unknown or not made of finite numbers; {REMAKE}")
        tensors[prefix][name.removeprefix(prefix)] = tensor
    if tensor_digest(found) != header.sha256:
        raise damaged(path)
    return header, tensors


def _check_shapes(make: Callable[[], torch.nn.Module], tensors: Mapping[str, Tensor], path: Path | str) -> None:
    """Compare the tensors with what the configuration wants, before anything of that size is made."""
    with torch.device("meta"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of layers of size 0, which do not fit either
        wanted = {name: (tuple(tensor.shape), tensor.dtype) for name, tensor in make().state_dict().items()}
    got = {name: (tuple(tensor.shape), tensor.dtype) for name, tensor in tensors.items()}
    if got != wanted:
        name = next(name for name in [*wanted, *got] if got.get(name) != wanted.get(name))
        raise InputError(
            f"{path}: tensors do not fit the stored configuration: {name[:60]} is {_said(got.get(name))}, wanted"
            f" {_said(wanted.get(name))}; {REMAKE}"
        )


def _said(found: tuple[tuple[int, ...], torch.dtype] | None) -> str:
    return "missing" if found is None else f"{str(found[1]).removeprefix('torch.')} of the shape {found[0]}"


def _check_layout(header: Header, model: RelationalModel, path: Path | str) -> None:
    """Compare the layout that the file states with the layout that this release derives from its configuration."""
    wanted = {
        "dt": model.config.dt,
        "history_steps": model.config.history_steps,
        "vocabulary": [str(k) for k in model.config.vocabulary],
        "state": list(model.dynamics.state),
        "action": list(model.dynamics.action),
    }
    for field, value in wanted.items():
        if getattr(header, field) != value:
            raise InputError(f"{path}: got {field} {getattr(header, field)}, this release wants {value}; {REMAKE}")
