"""The HTML page of a stress test says what its Markdown report says, and needs no other file."""

import base64
from pathlib import Path

import pytest

from cosim.show.stress_page import stress_page, write_stress_page
from gri.errors import InputError

REPORT = """\
# Stress test: merges

See [estimates.csv](estimates.csv).

## leader_braking

![Six measures](figures/leader_braking.png)

| intensity | policy |
|---|---|
| 3 | <script>alert(1)</script> |
| 8 | idm |
"""


def test_the_page_has_tables_contents_and_pictures(tmp_path: Path) -> None:
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "leader_braking.png").write_bytes(b"picture")
    (tmp_path / "stress.md").write_text(REPORT)
    text = write_stress_page(tmp_path).read_text()
    assert text.count("<h1>") == 1
    assert "<title>Stress test: merges</title>" in text
    assert '<a href="#leader_braking">leader braking</a>' in text
    assert '<h2 id="leader_braking">' in text
    assert f"data:image/png;base64,{base64.b64encode(b'picture').decode()}" in text
    assert text.count("<td>") == 4
    assert [path.name for path in tmp_path.iterdir() if path.suffix == ".part"] == []


def test_text_of_the_report_is_never_code(tmp_path: Path) -> None:
    assert "<script>" not in stress_page(REPORT, tmp_path)
    assert "<h2>x" not in stress_page("# a\n\n## <h2>x\n", tmp_path)


def test_a_folder_without_a_report_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no stress\.md in it"):
        write_stress_page(tmp_path)
