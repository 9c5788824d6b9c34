"""SUMO files of the user: what a configuration (.sumocfg) says, which files it names, and which options stay.

No SUMO is needed here. The coupling needs some options as they are (`coupling_options`); all others stay the user's.
SUMO doc: sumo, Configuration Files.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from cosim.spec.demand import Traffic
from gri.errors import InputError
from gri.resources import is_file

FILE_LISTS = ("net-file", "route-files", "additional-files")
_OTHER_FILES = ("weight-files",)
_SHORT_NAMES = {"n": "net-file", "r": "route-files", "a": "additional-files", "b": "begin", "e": "end"} | {
    "net": "net-file",
    "routes": "route-files",
    "additional": "additional-files",
    "route-file": "route-files",
    "additional-file": "additional-files",
}
_IGNORED = frozenset(
    {
        "end",
        "route-steps",
        "seed",
        "srand",
        "random",
        "step-length",
        "no-step-log",
        "duration-log.disable",
        "duration-log.statistics",
        "error-log",
        "log",
        "message-log",
        "verbose",
        "print-options",
        "xml-validation",
        "xml-validation.net",
        "xml-validation.routes",
        "remote-port",
        "num-clients",
        "start",
        "quit-on-end",
        "delay",
        "gui-settings-file",
        "game",
        "threads",
        "thread-rngs",
        "step-log.period",
        "no-warnings",
        "statistic-output",
        "summary",
        "human-readable-time",
        "save-configuration",
        "save-template",
        "collision.action",
        "collision.mingap-factor",
        "collision.check-junctions",
        "collision.stoptime",
    }
)
"""Options that the coupling sets itself, or that concern windows, messages and output files."""
_REFUSED = {
    "mesosim": "the mesoscopic model has no positions within a lane",
    "load-state": "a saved state brings vehicles that the warm-up does not know",
}


@dataclass(frozen=True)
class Configuration:
    """Options of SUMO by their long names, without files; the files, and the options that were not taken over."""

    net: Path | None = None
    routes: tuple[Path, ...] = ()
    additional: tuple[Path, ...] = ()
    begin: float = 0.0
    """Time [s] at which the simulation starts."""
    end: float | None = None
    """Time [s] at which the demand ends, None where nothing is said."""
    options: Mapping[str, str] = field(default_factory=dict)
    replaced: Mapping[str, str] = field(default_factory=dict)
    """Options of the user that the coupling sets itself, with the user's values."""

    @property
    def files(self) -> dict[str, Path]:
        """Every file, by what it is."""
        named = {"net": self.net} if self.net else {}
        for what in ("routes", "additional"):
            named |= {f"{what}.{k}": path for k, path in enumerate(getattr(self, what))}
        return named


def configuration(traffic: Traffic) -> Configuration:
    """All that the user's own files and options say. Raises `InputError` with the file and the option that is wrong."""
    options = read_configuration(Path(traffic.sumocfg)) if traffic.sumocfg else {}
    where = traffic.sumocfg or "traffic.options"
    for what, given in (("route-files", traffic.routes), ("additional-files", traffic.additional)):
        if given:
            options[what] = ",".join(given)
    own = {_SHORT_NAMES.get(name, name): _text(value) for name, value in traffic.options.items()}
    if misplaced := [name for name in own if name in FILE_LISTS]:
        raise InputError(
            f"traffic.options: got {misplaced[0]}; name files in net, traffic.routes and traffic.additional"
        )
    options |= own
    for name, reason in _REFUSED.items():
        if options.get(name, "false") not in ("", "false", "0"):
            raise InputError(f"{where}: got the option {name}, which cannot be used here: {reason}; remove it")
    return Configuration(
        net=next(iter(_paths(options.get("net-file", ""), where, "net-file")), None),
        routes=_paths(options.get("route-files", ""), where, "route-files"),
        additional=_paths(options.get("additional-files", ""), where, "additional-files"),
        begin=_seconds(options.get("begin", "0"), where, "begin"),
        end=_seconds(options["end"], where, "end") if options.get("end", "-1") not in ("", "-1") else None,
        options={name: value for name, value in options.items() if _is_kept(name)},
        replaced={
            name: value
            for name, value in options.items()
            if name in ("step-length", "seed", "collision.action", "collision.mingap-factor")
        },
    )


def read_configuration(path: Path) -> dict[str, str]:
    """The options of a SUMO configuration by their long names, with the paths of files relative to its folder resolved.

    Raises `InputError` if it is no such file.
    """
    if not is_file(path):
        raise InputError(f"traffic.sumocfg: no file {path} (looked in {Path.cwd()}); give a SUMO configuration file")
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise InputError(f"{path}:{error.position[0]}: not well-formed XML ({error}); correct it") from None
    except Exception as error:  # such as an encoding that does not exist
        raise InputError(f"{path}: cannot be read ({error}); save it as UTF-8") from None
    if not root.tag.endswith("onfiguration"):
        raise InputError(f"{path}: got a <{root.tag}> file, expected a SUMO <configuration>")
    options = {}
    for element in root.iter():
        value = element.get("value", element.get("v"))
        if value is not None:
            name = _SHORT_NAMES.get(element.tag, element.tag)
            names_files = name in (*FILE_LISTS, *_OTHER_FILES)
            options[name] = ",".join(_beside(path, part) for part in value.split(",")) if names_files else value
    return options


def _beside(path: Path, name: str) -> str:
    return str(path.parent / name.strip()) if name.strip() else ""


def _paths(names: str, where: str, option: str) -> tuple[Path, ...]:
    paths = tuple(Path(name) for name in names.split(",") if name)
    if missing := [path for path in paths if not is_file(path)]:
        raise InputError(f"{where}: {option} names {missing[0]}, but there is no such file; correct the name")
    return paths


def _seconds(text: str, where: str, option: str) -> float:
    """A time in seconds, or as SUMO's [days:]hours:minutes:seconds."""
    factors = (1, 60, 3600, 86400)
    parts = text.split(":")
    try:
        if len(parts) > len(factors):
            raise ValueError
        return float(sum(float(part) * factor for part, factor in zip(reversed(parts), factors, strict=False)))
    except ValueError:
        raise InputError(f"{where}: {option} is {text!r}, expected seconds or hours:minutes:seconds") from None


def _text(value: str | float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _is_kept(name: str) -> bool:
    """Whether an option stays the user's: it is no file handled elsewhere, no window, no output."""
    return name not in (*FILE_LISTS, *_IGNORED) and "output" not in name and not name.startswith("gui")
