"""The HTML templates, and the style and script that every page carries inside itself."""

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

FOLDER = Path(__file__).parent / "templates"


def page(template: str, **content: Any) -> str:
    """A page with nothing outside itself: style and script stand in it."""
    environment = Environment(
        loader=FileSystemLoader(FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    inside = {name: (FOLDER / name).read_text() for name in ("style.css", "animation.js")}
    return environment.get_template(template).render(
        style=inside["style.css"], script=inside["animation.js"], **content
    )
