"""Additional files of the user write nothing while branches of the simulation run."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

from cosim.traffic.additional_file import without_outputs
from gri.errors import InputError


def test_detectors_write_nowhere_and_other_files_are_found_from_anywhere(tmp_path: Path) -> None:
    path = tmp_path / "detectors.add.xml"
    path.write_text(
        '<additional><inductionLoop id="a" lane="x_0" pos="1" period="60" file="out.xml"/>'
        '<rerouter id="r" edges="x" file="closed.xml"/><calibrator id="c" output="flow.xml"/></additional>'
    )
    text = without_outputs(path)
    assert text is not None
    detector, rerouter, calibrator = ElementTree.fromstring(text)
    assert detector.attrib == {"id": "a", "lane": "x_0", "pos": "1", "period": "60", "file": "NUL"}
    assert rerouter.get("file") == str(tmp_path.resolve() / "closed.xml")
    assert calibrator.get("output") == "NUL"


def test_a_file_without_output_stays_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "types.add.xml"
    path.write_text('<additional><vType id="quick" accel="3"/></additional>')
    assert without_outputs(path) is None


def test_what_is_no_xml_is_one_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "broken.add.xml"
    path.write_text("<additional>\n<vType></additional>")
    with pytest.raises(InputError, match=r"broken.add.xml:2: not well-formed XML"):
        without_outputs(path)
