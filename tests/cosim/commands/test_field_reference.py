"""The reference of YAML fields is generated, whole, and the one in the documentation."""

from pathlib import Path

from cosim.batch.spec import Batch
from cosim.commands.field_reference import markdown
from cosim.spec.scenario import Scenario

DOCUMENT = Path(__file__).parents[3] / "docs/reference/yaml-fields.md"


def test_the_document_is_what_the_command_prints():
    assert DOCUMENT.read_text() == markdown(), "run `cosim schema --markdown > docs/reference/yaml-fields.md`"


def test_every_field_is_in_it():
    text = markdown()
    for kind in (Scenario, Batch):
        assert all(f"| `{field}` |" in text for field in kind.__struct_fields__)


def test_every_link_leads_to_a_section():
    import re

    text = markdown()
    sections = {line.removeprefix("### ").lower() for line in text.splitlines() if line.startswith("### ")}
    assert set(re.findall(r"\]\(#(\w+)\)", text)) <= sections
