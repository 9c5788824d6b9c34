"""Models as files: a dict of tensors and JSON text, which is read without running code from the file.

Functions that read take the path of a file or the name of a released checkpoint, such as "us101_merge". They raise
`InputError` if there is no such file, if it is damaged, or if it does not fit this release
(docs/decisions/004-checkpoints.md).
"""

import os
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import torch
from torch import Tensor

from gri.core.graph import FOLLOWING
from gri.errors import InputError, guarded_reading
from gri.networks.model import ModelConfig, RelationalModel
from gri.resources import find_checkpoint
from gri.rewards.structured import AssumedReward, LaneRewardConfig, NaturalisticConfig, RewardConfig, StructuredReward

FORMAT = "gri-checkpoint"
VERSION = 1


def save(
    path: Path | str,
    model: RelationalModel,
    reward: StructuredReward | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Write a model, the reward it was grounded in, and how both were made (any values that JSON can hold).

    The file appears whole or not at all; its folder is made if it is missing.
    """
    config, dynamics = model.config, model.dynamics
    _write(
        Path(path),
        {
            "format": FORMAT,
            "version": VERSION,
            "config": msgspec.json.encode(config).decode(),
            "dt": config.dt,
            "history_steps": config.history_steps,
            "vocabulary": [str(k) for k in config.vocabulary],
            "state": list(dynamics.state),
            "action": list(dynamics.action),
            "tensors": _tensors(model),
            "reward_config": msgspec.json.encode(reward.config).decode() if reward else "",
            "reward_tensors": _tensors(reward) if reward else {},
            "provenance": msgspec.json.encode(dict(provenance or {})).decode(),
        },
    )


def _tensors(module: torch.nn.Module) -> dict[str, Tensor]:
    return {name: tensor.detach().clone() for name, tensor in module.state_dict().items()}


def _write(path: Path, content: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            torch.save(content, file)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


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
    content = _read(path)
    with guarded_reading(path, "checkpoint", _REMAKE):
        config = _decoded(content["config"], ModelConfig, path)
        _check_shapes(lambda: RelationalModel(config), content["tensors"], path)
        model = RelationalModel(config)
        _check_layout(content, model, path)
        model.load_state_dict(content["tensors"])
        return model.requires_grad_(False).eval()


def load_reward(path: Path | str) -> StructuredReward | None:
    """The reward that the model of a checkpoint was grounded in, with fixed weights; None if it has none."""
    content = _read(path)
    with guarded_reading(path, "checkpoint", _REMAKE):
        if not content["reward_config"]:
            return None
        kind = RewardConfig if tuple(content["vocabulary"]) == FOLLOWING else LaneRewardConfig
        if "type" in msgspec.json.decode(content["reward_config"]):
            kind = NaturalisticConfig | AssumedReward
        config = _decoded(content["reward_config"], kind, path)
        _check_shapes(lambda: StructuredReward(config), content["reward_tensors"], path)
        reward = StructuredReward(config)
        reward.load_state_dict(content["reward_tensors"])
        return reward.requires_grad_(False).eval()


def provenance(path: Path | str) -> dict[str, Any]:
    """How a checkpoint was made: configuration, seed, versions and scores."""
    content = _read(path)
    with guarded_reading(path, "checkpoint", _REMAKE):
        return msgspec.json.decode(content["provenance"], type=dict[str, Any])


def objective(path: Path | str) -> str:
    """The objective that a model was trained with: "gri", "nri", "supervised", …; "gri" if the file does not say."""
    name: Any = provenance(path)
    for field in ("config", "objective", "type"):
        name = name.get(field) if isinstance(name, dict) else None
    name = name if isinstance(name, str) else "gri"
    return name.removesuffix("_recorded").removesuffix("_told")


_REMAKE = "make it again with `gri train`"
_FIELDS = {
    "config": str,
    "vocabulary": list,
    "tensors": dict,
    "reward_config": str,
    "reward_tensors": dict,
    "provenance": str,
}


def _read(path: Path | str) -> dict[str, Any]:
    path = find_checkpoint(path)
    with guarded_reading(path, "checkpoint", _REMAKE):
        with zipfile.ZipFile(path) as archive:
            sizes = [(member.compress_type, member.file_size) for member in archive.infolist()]
            packed = any(kind != zipfile.ZIP_STORED for kind, _ in sizes)
            if packed or sum(size for _, size in sizes) > path.stat().st_size:
                raise InputError(f"{path}: its content is compressed, which a checkpoint never is; {_REMAKE}")
            if damaged := archive.testzip():
                raise InputError(f"{path}: its part {damaged[:60]} is damaged; {_REMAKE}")
        content = torch.load(path, map_location="cpu", weights_only=True)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(f"{path}: a torch file, but not a {FORMAT}; give a file written by `gri train`")
    if content.get("version") != VERSION:
        raise InputError(
            f"{path}: got format version {content.get('version')}, this release reads {VERSION}; {_REMAKE}"
        )
    for field, kind in _FIELDS.items():
        if not isinstance(content.get(field), kind):
            raise InputError(f"{path}: its field {field} is missing or no {kind.__name__}; {_REMAKE}")
    for name, tensor in (content["tensors"] | content["reward_tensors"]).items():
        right = isinstance(tensor, Tensor) and tensor.layout is torch.strided and tensor.is_contiguous()
        if not right or not torch.isfinite(tensor).all():
            raise InputError(f"{path}: its tensor {str(name)[:60]} is not made of finite numbers; {_REMAKE}")
    return content


def _check_shapes(make: Callable[[], torch.nn.Module], tensors: Mapping[str, Tensor], path: Path | str) -> None:
    """Compare the tensors with what the configuration wants, before anything of that size is made."""
    with torch.device("meta"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of layers of size 0, which do not fit either
        wanted = {name: tuple(tensor.shape) for name, tensor in make().state_dict().items()}
    got = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    if got != wanted:
        name = next(name for name in [*wanted, *got] if got.get(name) != wanted.get(name))
        raise InputError(
            f"{path}: tensors do not fit the stored configuration: {name[:60]} has the shape {got.get(name)}, wanted"
            f" {wanted.get(name)}; {_REMAKE}"
        )


def _decoded(text: str, kind: Any, path: Path | str) -> Any:
    try:
        return msgspec.json.decode(text, type=kind)
    except msgspec.DecodeError as error:
        raise InputError(f"{path}: its stored configuration does not fit this release ({error}); {_REMAKE}") from error


def _check_layout(content: dict[str, Any], model: RelationalModel, path: Path | str) -> None:
    """Compare the layout that the file states with the layout that this release derives from its configuration."""
    wanted = {
        "dt": model.config.dt,
        "history_steps": model.config.history_steps,
        "vocabulary": [str(k) for k in model.config.vocabulary],
        "state": list(model.dynamics.state),
        "action": list(model.dynamics.action),
    }
    for field, value in wanted.items():
        if content.get(field) != value:
            raise InputError(f"{path}: got {field} {content.get(field)}, this release wants {value}; {_REMAKE}")
