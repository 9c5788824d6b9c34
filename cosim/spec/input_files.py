"""The input files of a scenario (net, checkpoint, policy, recording), found and hashed without torch or SUMO."""

import hashlib
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

from cosim.spec.scenario import Replay, Scenario, TrainedPolicy, UserPolicy
from cosim.spec.sumo_configuration import configuration
from gri.errors import InputError
from gri.resources import find_checkpoint, shipped


def find_net(name: str) -> Path:
    """The net file of that name (shipped in `sumo_nets/`) or path. Raises `InputError` if it is not a SUMO net."""
    path = next((p for p in (Path(name), shipped("sumo_nets", name, f"{name}.net.xml")) if p.is_file()), None)
    if path is None:
        known = ", ".join(sorted(p.parent.name for p in shipped("sumo_nets").glob("*/*.net.xml")))
        raise InputError(f"net: no net {name!r}: expected the path of a .net.xml file or a shipped name ({known})")
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise InputError(f"{path}:{error.position[0]}: not well-formed XML ({error}); build the net again") from None
    if root.tag != "net":
        raise InputError(f"{path}: got a <{root.tag}> file, expected a SUMO <net>; build one with netconvert")
    return path


def input_files(scenario: Scenario) -> dict[str, Path]:
    """Every input file of a run besides the scenario: net, checkpoint, source file of the policy, recording."""
    files = {"net": find_net(scenario.net)}
    if scenario.traffic.has_own_files:
        own = configuration(scenario.traffic).files
        files |= {what: path for what, path in own.items() if what != "net"}
        if scenario.traffic.sumocfg:
            files["sumocfg"] = Path(scenario.traffic.sumocfg)
    if isinstance(scenario.policy, TrainedPolicy):
        files["checkpoint"] = checkpoint_path(scenario.policy.checkpoint)
    if isinstance(scenario.policy, UserPolicy):
        files["policy"] = source_path(scenario.policy)
    if isinstance(scenario.background, Replay):
        files["recording"] = recording_path(scenario.background)
    return files


def recording_path(background: Replay) -> Path:
    """The NGSIM file that a background replays. Raises `InputError` if there is none."""
    if not background.recording:
        raise InputError("background.recording: the scenario names no recording; give one with --recording FILE")
    path = Path(background.recording)
    if not path.is_file():
        raise InputError(
            f"background.recording: no file {path} (looked in {Path.cwd()}); give an NGSIM trajectory file"
        )
    return path


def source_path(policy: UserPolicy) -> Path:
    """The Python file of a user's policy. Raises `InputError` if there is none."""
    place = policy.object.rpartition(":")[0]
    if place.endswith(".py"):
        path = Path(place)
    else:
        try:
            found = find_spec(place)
        except ModuleNotFoundError:
            found = None
        if found is None or not found.origin:
            raise InputError(
                f"policy.object: no module {place!r} is installed; for a file of your own write 'file.py:Name'"
            )
        path = Path(found.origin)
    if not path.is_file():
        raise InputError(f"policy.object: no file {place!r} (looked in {Path.cwd()}); give the path of a Python file")
    return path


def checkpoint_path(name: str, field: str = "policy.checkpoint") -> Path:
    """The file of the checkpoint that a field or option names, by path or by the name of a released one.

    Raises `InputError` if there is no such file.
    """
    return find_checkpoint(name, field)


def sha256(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
