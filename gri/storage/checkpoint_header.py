"""What a checkpoint says about itself, and whether its tensors are undamaged; needs no torch.

`gri.checkpoint` makes the model. A command that has much to do before it needs the model looks here first.
"""

import hashlib
import zipfile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from safetensors import safe_open

from gri.errors import InputError, guarded_reading

FORMAT = "gri-checkpoint"  # the one key of the file's metadata; with several keys its bytes would not repeat
VERSION = 2
REMAKE = "make it again with `gri train`"


class Header(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a checkpoint says about its tensors: format, configuration, and the layout that it was trained for."""

    version: int
    sha256: str
    """Of names, types, shapes and values of all tensors, in alphabetical order."""
    config: dict[str, Any]
    dt: float
    """[s]"""
    history_steps: int
    vocabulary: list[str]
    state: list[str]
    action: list[str]
    reward_config: dict[str, Any] | None
    provenance: dict[str, Any]

    @property
    def objective(self) -> str:
        """The objective that the model was trained with: "gri", "nri", …; "gri" if the file does not say."""
        name: Any = self.provenance
        for field in ("config", "objective", "type"):
            name = name.get(field) if isinstance(name, dict) else None
        name = name if isinstance(name, str) else "gri"
        return name.removesuffix("_recorded").removesuffix("_told")


def refuse_old_format(path: Path) -> None:
    """Raise `InputError` for a file of torch."""
    if zipfile.is_zipfile(path):
        raise InputError(f"{path}: a file of torch, such as version 0.1 wrote; expected safetensors; {REMAKE}")


def header_of(metadata: dict[str, str] | None, path: Path) -> Header:
    """The header in the metadata of a file. Raises `InputError` if there is none of this release."""
    text = (metadata or {}).get(FORMAT)
    if text is None:
        raise InputError(f"{path}: a safetensors file, but not a {FORMAT}; give a file written by `gri train`")
    version = msgspec.json.decode(text, type=dict[str, Any]).get("version")
    if version != VERSION:
        raise InputError(f"{path}: got format version {version}, this release reads {VERSION}; {REMAKE}")
    return typed(msgspec.json.decode(text), Header, path)


def typed(content: Any, kind: Any, path: Path | str) -> Any:
    """Plain content as a value of a kind. Raises `InputError` if it does not fit."""
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: its stored configuration does not fit this release ({error}); {REMAKE}") from error


def damaged(path: Path | str) -> InputError:
    """The error for tensors that are not those that were written."""
    return InputError(f"{path}: its tensors are damaged (their SHA-256 differs from that in the header); {REMAKE}")


def checked_header(path: Path) -> Header:
    """The header of a checkpoint whose tensors are those that were written.

    Raises `InputError` if the file is no checkpoint of this release, or is damaged. Whether the tensors fit the
    configuration is seen when the model is made.
    """
    with guarded_reading(path, "checkpoint", REMAKE):
        refuse_old_format(path)
        total = hashlib.sha256()
        with safe_open(path, "np") as file:
            header = header_of(file.metadata(), path)
            for name in sorted(file.keys()):
                tensor: np.ndarray = file.get_tensor(name)
                total.update(f"{name} torch.{tensor.dtype} {tensor.shape}\n".encode())
                total.update(tensor.tobytes())
        if total.hexdigest() != header.sha256:
            raise damaged(path)
    return header
