"""The HTML templates; style and script are embedded in every page."""

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

FOLDER = Path(__file__).parent / "templates"


def page(template: str, **content: Any) -> str:
    """The HTML page of a template with this content. It loads nothing from outside."""
    environment = Environment(
        loader=FileSystemLoader(FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    inside = {name: (FOLDER / name).read_text(encoding="utf-8") for name in ("style.css", "animation.js")}
    return environment.get_template(template).render(
        style=inside["style.css"], script=inside["animation.js"], **content
    )
