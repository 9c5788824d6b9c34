"""Where the files that come with the project are: scenarios, nets and released checkpoints.

A source tree keeps `scenarios/` and `sumo_nets/` at its top level. A wheel carries the same folders inside the package,
so that names like `us101_car_following` work from anywhere after an install.
"""

from pathlib import Path

from gri.errors import InputError

PACKAGE = Path(__file__).parent


def shipped(*parts: str) -> Path:
    """The path of a file or folder that comes with the project, e.g. `shipped("scenarios", "x.yaml")`."""
    bundled = PACKAGE / "_bundled"
    return (bundled if bundled.is_dir() else PACKAGE.parent).joinpath(*parts)


def checkpoints() -> list[str]:
    """Names of the released checkpoints, in alphabetical order."""
    return sorted(path.stem for path in (PACKAGE / "checkpoints").glob("*.safetensors"))


def is_file(path: Path) -> bool:
    """Whether there is a file of that path; a path that no system could have is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, or with a character that no name has
        return False


def find_checkpoint(given: str | Path, field: str = "") -> Path:
    """The file of a checkpoint, given by its path or by the name of a released one; a file of that path comes first.

    Raises `InputError` if there is neither; the message begins with `field`, the field of a YAML file that named it.
    """
    for path in (Path(given), PACKAGE / "checkpoints" / f"{given}.safetensors"):
        if is_file(path):
            return path
    where = f"{field}: " if field else ""
    raise InputError(
        f"{where}no checkpoint {str(given)!r}: expected the path of a file or a released name"
        f" ({', '.join(checkpoints())}); make one with `gri train`"
    )
