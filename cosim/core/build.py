"""Building the compiled core, and deciding which core runs.

The core is one C++ file. It is compiled against the headers of the `eclipse-sumo` package and linked to the library of
the `libsumo` package, so that it sees the simulation that Python runs. It is kept in the user's cache folder, under a
name made from all that it depends on.
"""

import hashlib
import importlib.metadata
import importlib.util
import os
import shutil
import subprocess
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from gri.errors import InputError

SWITCH = "COSIM_CORE"
"""The environment variable that chooses: auto (compiled where it is built), python, compiled (or an error)."""
CHOICES = "auto", "python", "compiled"
SOURCE = Path(__file__).with_name("step_core.cpp")
# No fused multiply-add: it rounds once where Python rounds twice.
OPTIONS = "-std=c++17", "-O2", "-ffp-contract=off", "-shared", "-fPIC"
BUILD = "build it with `cosim doctor --build-core`"


@dataclass(frozen=True)
class CoreStatus:
    """Which core runs: the `library` of the compiled one or None for Python, and why."""

    library: Path | None
    reason: str


@lru_cache(maxsize=1)
def core_status() -> CoreStatus:
    """Which core runs in this process.

    Raises `InputError` where COSIM_CORE has another value than CHOICES, or is `compiled` and no core is built.
    """
    wanted = os.environ.get(SWITCH, "auto")
    if wanted not in CHOICES:
        raise InputError(f"{SWITCH}: got {wanted!r}, wanted one of {', '.join(CHOICES)}")
    if wanted == "python":
        return CoreStatus(None, f"{SWITCH} is python")
    library = _library_file()
    if library is not None and library.is_file():
        return CoreStatus(library, f"it is built; {SWITCH}=python would not use it")
    if wanted == "compiled":
        raise InputError(f"{SWITCH}: got compiled, but no core is built for this version; {BUILD}")
    return CoreStatus(None, f"no compiled core is built for this version; {BUILD}")


def build_core() -> Path:
    """Compile the core, unless this version is built already; returns its file.

    Raises `InputError` where there is no compiler, no package with headers, or an error in compiling.
    """
    compiler, headers, libsumo = _compiler(), _headers(), _libsumo()
    if compiler is None:
        raise InputError("found no C++ compiler (CXX, c++, g++, clang++); install one, or go on without: Python drives")
    if headers is None:
        raise InputError(
            "found no headers of libsumo; install them with the extra `sumo` of this package (eclipse-sumo)"
        )
    if libsumo is None:
        raise InputError("found no library of libsumo; install the package libsumo")
    library = _library_file()
    assert library is not None
    if library.is_file():
        return library
    library.parent.mkdir(parents=True, exist_ok=True)
    unfinished = library.with_name(f"{library.name}.{os.getpid()}")
    link = [f"-L{libsumo.parent}", f"-l:{libsumo.name}", f"-Wl,-rpath,{libsumo.parent}"]
    command = [*compiler, *OPTIONS, f"-I{headers}", str(SOURCE), "-o", str(unfinished), *link]
    done = subprocess.run([*command, "-Wl,--allow-shlib-undefined"], capture_output=True, text=True, check=False)
    if done.returncode:
        unfinished.unlink(missing_ok=True)
        raise InputError(f"the compiler {compiler[0]} failed:\n{done.stderr.strip()[-2000:]}")
    unfinished.replace(library)
    core_status.cache_clear()
    return library


def _library_file() -> Path | None:
    """Where the core of this version is, or would be; None without libsumo."""
    libsumo = _libsumo()
    if libsumo is None:
        return None
    version = importlib.metadata.version("libsumo")
    depends_on = [SOURCE.read_bytes(), *(text.encode() for text in (version, str(libsumo), *OPTIONS))]
    name = hashlib.sha256(b"\0".join(depends_on)).hexdigest()[:16]
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "gri-cosim" / f"step_core-{name}.so"


def _compiler() -> list[str] | None:
    given = os.environ.get("CXX", "").split()
    names = [given] if given else [["c++"], ["g++"], ["clang++"]]
    return next((name for name in names if shutil.which(name[0])), None)


def _headers() -> Path | None:
    """The folder in which `libsumo/Vehicle.h` is: that of the package eclipse-sumo."""
    found = importlib.util.find_spec("sumo")
    places = [] if found is None else [Path(place, "include") for place in found.submodule_search_locations or ()]
    return next((place for place in places if (place / "libsumo" / "Vehicle.h").is_file()), None)


def _libsumo() -> Path | None:
    """The library that Python loads as `libsumo._libsumo`."""
    found = importlib.util.find_spec("libsumo")
    places = [] if found is None else [Path(place, "_libsumo.so") for place in found.submodule_search_locations or ()]
    return next((place for place in places if place.is_file()), None)
