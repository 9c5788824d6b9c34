"""The HTML page of a stress test: its Markdown report with style, a list of contents and the pictures inside."""

import base64
import re
from html import escape
from pathlib import Path

from markdown_it import MarkdownIt

from cosim.show.templates import page
from gri.errors import InputError
from gri.storage.whole_files import write_whole

REPORT, PAGE = "stress.md", "stress.html"


def write_stress_page(folder: Path) -> Path:
    """Write `stress.html` beside the `stress.md` of a stress test; it needs no other file and no network.

    Raises `InputError` if the folder has no report.
    """
    report = folder / REPORT
    if not report.is_file():
        raise InputError(f"{folder}: no {REPORT} in it; give a folder that `cosim stress` wrote")
    write_whole(folder / PAGE, stress_page(report.read_text(encoding="utf-8"), folder))
    return folder / PAGE


def stress_page(report: str, folder: Path) -> str:
    """The page for a Markdown report, whose pictures are read from `folder`."""
    # HTML in the text stays text: names of policies and reasons come from outside.
    html = MarkdownIt("commonmark", {"html": False}).enable("table").render(report)
    html = re.sub(r"<h1>.*?</h1>\n?", "", html, count=1, flags=re.S)
    html = html.replace("<table>", '<div class="scroll"><table>').replace("</table>", "</table></div>")
    html = re.sub(
        r'<img src="(figures/[\w.-]+\.png)"', lambda found: f'<img src="{_embedded(folder / found[1])}"', html
    )
    names = re.findall(r"<h2>([^<]*)</h2>", html)
    html = re.sub(r"<h2>([^<]*)</h2>", lambda found: f'<h2 id="{escape(found[1])}">{found[1]}</h2>', html)
    title = re.search(r"^# (.*)$", report, re.M)
    return page("stress.html.j2", title=title[1] if title else folder.name, names=names, report=html)


def _embedded(picture: Path) -> str:
    """The picture as a data address, or its path where it is missing."""
    if not picture.is_file():
        return f"{picture.parent.name}/{picture.name}"
    return f"data:image/png;base64,{base64.b64encode(picture.read_bytes()).decode()}"
