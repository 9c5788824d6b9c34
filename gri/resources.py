"""Where the files that come with the project are.

A source tree keeps `scenarios/` and `sumo_nets/` at its top level; a wheel carries the same folders inside
the package, so that names like `us101_car_following` work from anywhere after an install.
"""

from pathlib import Path

PACKAGE = Path(__file__).parent


def shipped(*parts: str) -> Path:
    """The path of a file or folder that comes with the project, e.g. `shipped("scenarios", "x.yaml")`."""
    bundled = PACKAGE / "_bundled"
    return (bundled if bundled.is_dir() else PACKAGE.parent).joinpath(*parts)


def checkpoint(name: str) -> Path:
    """The path of a released checkpoint, by its bare name."""
    return PACKAGE / "checkpoints" / f"{name}.pt"


def checkpoint_at(given: str | Path) -> Path:
    """The path of a checkpoint given as such (with an ending), or by the bare name of a released one."""
    return Path(given) if Path(given).suffix else checkpoint(str(given))


def checkpoints() -> list[str]:
    """Names of the released checkpoints."""
    return sorted(path.stem for path in (PACKAGE / "checkpoints").glob("*.pt"))
