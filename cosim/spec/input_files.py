"""The input files of a scenario (net, checkpoint, policy, recording), found and hashed without torch or SUMO."""

import gzip
import hashlib
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.parsers import expat

from cosim.spec.scenario import Driver, Replay, Scenario, TrainedPolicy, UserPolicy
from cosim.spec.sumo_configuration import configuration
from gri.errors import InputError
from gri.resources import find_checkpoint, is_file, shipped

GZIP = b"\x1f\x8b"  # the first bytes of a compressed file
DEEPEST = 100  # elements in one another
LARGEST_NET = 4 * 2**30  # bytes


def find_net(name: str) -> Path:
    """The net file of that name (shipped in `sumo_nets/`) or path. Raises `InputError` if it is not a SUMO net."""
    path = next((p for p in (Path(name), shipped("sumo_nets", name, f"{name}.net.xml")) if is_file(p)), None)
    if path is None:
        known = ", ".join(sorted(p.parent.name for p in shipped("sumo_nets").glob("*/*.net.xml")))
        raise InputError(f"net: no net {name!r}: expected the path of a .net.xml file or a shipped name ({known})")
    if (root := xml_root(path, "build the net again with netconvert")) != "net":
        raise InputError(f"{path}: got a <{root}> file, expected a SUMO <net>; build one with netconvert")
    return path


def xml_root(path: Path, fix: str) -> str:
    """The name of the root element of an XML file, which may be compressed with gzip and is read to its end.

    Raises `InputError`, which ends with what to do (`fix`), if the file is not well-formed, nests deeper than any map
    or net (SUMO's reader takes minutes for such a file), or is larger than LARGEST_NET.
    """
    state = path.stat()
    return _root_of(path, fix, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=100)
def _root_of(path: Path, fix: str, changed: int, size: int) -> str:
    """As `xml_root`; `changed` and `size` are those of the file, so that one that was changed is read again."""
    del changed, size
    open_elements: list[str] = []
    roots: list[str] = []
    parser = expat.ParserCreate()

    def begin(name: str, _: dict[str, str]) -> None:
        if not open_elements:
            roots.append(name)
        open_elements.append(name)
        if len(open_elements) > DEEPEST:
            raise InputError(f"{path}:{parser.CurrentLineNumber}: XML nests deeper than {DEEPEST} elements; {fix}")

    parser.StartElementHandler, parser.EndElementHandler = begin, lambda _: open_elements.pop()
    try:
        with path.open("rb") as raw, gzip.open(raw) if raw.peek(2)[:2] == GZIP else raw as file:
            while part := file.read(2**20):
                parser.Parse(part)
                if file.tell() > LARGEST_NET:
                    raise InputError(f"{path}: more than {LARGEST_NET // 2**30} GiB of XML; give a smaller file")
            parser.Parse(b"", True)
    except InputError:
        raise
    except Exception as error:  # whatever is wrong with the compression, the encoding or the XML
        line = f":{error.lineno}" if isinstance(error, expat.ExpatError) else ""
        raise InputError(f"{path}{line}: not well-formed XML ({error}); {fix}") from None
    return roots[0]


def input_files(scenario: Scenario) -> dict[str, Path]:
    """Every input file of a run besides the scenario: net, checkpoint, source file of the policy, recording."""
    files = {"net": find_net(scenario.net)}
    if scenario.traffic.has_own_files:
        own = configuration(scenario.traffic).files
        files |= {what: path for what, path in own.items() if what != "net"}
        if scenario.traffic.sumocfg:
            files["sumocfg"] = Path(scenario.traffic.sumocfg)
    files |= files_of_policy(scenario.policy, "")
    for name, part in scenario.shares.items():
        files |= files_of_policy(part.policy, f".{name}")
    if isinstance(scenario.background, Replay):
        files["recording"] = recording_path(scenario.background)
    return files


def files_of_policy(policy: Driver, name: str = "") -> dict[str, Path]:
    """The checkpoint of a policy, or the source file of one's own and the files that its settings name."""
    if isinstance(policy, TrainedPolicy):
        return {f"checkpoint{name}": checkpoint_path(policy.checkpoint)}
    if not isinstance(policy, UserPolicy):
        return {}
    texts = {key: Path(value) for key, value in policy.settings.items() if isinstance(value, str)}
    named = {f"policy{name}.{key}": path for key, path in texts.items() if is_file(path)}
    return {f"policy{name}": source_path(policy)} | named


def recording_path(background: Replay) -> Path:
    """The recording that a background replays. Raises `InputError` if there is none."""
    if not background.recording:
        raise InputError("background.recording: the scenario names no recording; give one with --recording FILE")
    path = Path(background.recording)
    if not is_file(path):
        raise InputError(
            f"background.recording: no file {path} (looked in {Path.cwd()}); give a recording (docs/recordings.md)"
        )
    return path


def source_path(policy: UserPolicy) -> Path:
    """The Python file of a user's policy. Raises `InputError` if there is none."""
    place = policy.object.rpartition(":")[0]
    path = Path(place) if place.endswith(".py") else _module_file(place)
    if path is None:
        raise InputError(
            f"policy.object: no module {place!r} is installed; for a file of your own write 'file.py:Name'"
        )
    if not is_file(path):
        raise InputError(f"policy.object: no file {place!r} (looked in {Path.cwd()}); give the path of a Python file")
    return path


def refuse_foreign_code(content: Any, file: Path, allowed: bool) -> None:
    """Raise `InputError` where a file names code that is not in its own folder and is not `allowed`.

    `content` is plain: a scenario, a batch, or a part of one. Everybody who runs such a file runs the code that it
    names, and looks at the file itself at most.
    """
    waiting = [] if allowed else [content]
    while waiting:
        value = waiting.pop()
        if isinstance(value, list | tuple):
            waiting += value
        elif isinstance(value, dict):
            waiting += value.values()
            named = value.get("object") if value.get("kind") == UserPolicy.__struct_config__.tag else None
            if isinstance(named, str) and not _is_inside(named.rpartition(":")[0], file.parent):
                raise InputError(
                    f"{file}: policy.object names code outside the folder of this file ({named}), which would run here;"
                    " add --allow-code if you trust it"
                )


def _is_inside(place: str, folder: Path) -> bool:
    return place.endswith(".py") and Path(place).resolve().is_relative_to(folder.resolve())


def _module_file(name: str) -> Path | None:
    """The file of a module, found without importing anything: `importlib.util.find_spec` would import its packages."""
    places, path = None, None
    for k in range(name.count(".") + 1):
        part = ".".join(name.split(".")[: k + 1])
        finders = (finder.find_spec for finder in sys.meta_path if hasattr(finder, "find_spec"))
        try:
            found = next((spec for find in finders if (spec := find(part, places))), None)
        except Exception:  # a name that is no module's
            return None
        if found is None:
            return None
        places, path = found.submodule_search_locations, found.origin
    return Path(path) if path else None


def checkpoint_path(name: str, field: str = "policy.checkpoint") -> Path:
    """The file of the checkpoint that a field or option names, by path or by the name of a released one.

    Raises `InputError` if there is no such file.
    """
    return find_checkpoint(name, field)


def sha256(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
