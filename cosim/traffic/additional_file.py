"""Additional files of the user, without what they write.

Branches of a simulation share the files that SUMO has open. Detectors would therefore mix the output of all branches,
so they go on counting but write nothing (SUMO doc: Additional Files; Output).
"""

from pathlib import Path
from xml.etree import ElementTree

from gri.errors import InputError

OUTPUTS = frozenset(
    {
        "e1Detector",
        "inductionLoop",
        "instantInductionLoop",
        "e2Detector",
        "laneAreaDetector",
        "e3Detector",
        "entryExitDetector",
        "routeProbe",
        "vTypeProbe",
        "edgeData",
        "laneData",
        "timedEvent",
    }
)
_FILE_ATTRIBUTES = ("file", "href", "output", "dest")


def without_outputs(path: Path) -> str | None:
    """The file with all its output sent nowhere and its paths made absolute; None if it writes nothing.

    Raises `InputError` if the file is not XML.
    """
    try:
        tree = ElementTree.parse(path)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}:{error.position[0]}: not well-formed XML ({error}); correct it") from None
    except Exception as error:  # such as an encoding that does not exist
        raise InputError(f"{path}: cannot be read ({error}); give an additional file of SUMO") from None
    writes = False
    for element in tree.iter():
        for name in _FILE_ATTRIBUTES:
            if name not in element.attrib:
                continue
            if element.tag in OUTPUTS or name == "output":
                writes = True
                element.set(name, "NUL")
            elif name in ("file", "href"):
                element.set(name, str((path.parent / element.attrib[name]).resolve()))
    return ElementTree.tostring(tree.getroot(), encoding="unicode") if writes else None
