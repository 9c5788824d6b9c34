"""The documentation site builds without a warning, and no page of it asks another host for anything."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import pytest

pytest.importorskip("material", reason="needs the extra `docs`")
pytest.importorskip("mkdocstrings", reason="needs the extra `docs`")

ROOT = Path(__file__).parents[2]
FETCHED = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src", "video": "src"}
FETCHED |= {"audio": "src", "embed": "src", "object": "data", "use": "href", "image": "href"}
ELSEWHERE = re.compile(r"^\s*(?:[a-z]+:)?//", re.IGNORECASE)
STYLE = re.compile(r"(?:@import\s+|url\()\s*(?:url\()?[\"']?((?:https?:)?//[^\"')\s]+)")


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


class Requests(HTMLParser):
    """Collects what a browser fetches by itself when it shows the page, and whether Mermaid would be loaded."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        targets = [given.get(FETCHED.get(tag, "")), *(part.split()[0] for part in _parts(given.get("srcset")))]
        if "mermaid" in (given.get("class") or "").split():
            self.found.append("mermaid is loaded from another host; draw an SVG instead")
        self.found += [f"<{tag}> {target}" for target in targets if target and ELSEWHERE.match(target)]
        self.found += STYLE.findall(given.get("style") or "")


def _parts(srcset: str | None) -> list[str]:
    return [part for part in (srcset or "").split(",") if part.strip()]


def requests_of(site: Path) -> Iterator[str]:
    for page in sorted(site.rglob("*.html")):
        parser = Requests()
        text = page.read_text()
        parser.feed(text)
        styles = "\n".join(re.findall(r"<style.*?</style>", text, re.DOTALL))
        yield from (f"{page.relative_to(site)}: {target}" for target in [*parser.found, *STYLE.findall(styles)])
    for style in sorted(site.rglob("*.css")):
        yield from (f"{style.relative_to(site)}: {target}" for target in STYLE.findall(style.read_text()))


def test_no_page_asks_another_host(site):
    assert not list(requests_of(site))


def test_the_check_sees_requests(tmp_path):
    (tmp_path / "a.html").write_text(
        '<link rel="stylesheet" href="https://fonts.example/x.css"><script src="//cdn.example/x.js"></script>'
        '<img srcset="a.png 1x, https://example.org/b.png 2x"><style>@import "https://example.org/c.css";</style>'
        '<pre class="mermaid"></pre><a href="https://example.org">a link is no request</a>'
    )
    assert len(list(requests_of(tmp_path))) == 5


def test_every_page_can_be_reached_from_the_navigation(site):
    """Decision notes and released tables are reached from their indexes; every other page has an entry."""
    home = (site / "index.html").read_text()
    pages = {str(path.relative_to(ROOT / "docs").with_suffix(".html")) for path in (ROOT / "docs").glob("**/*.md")}
    pages = {page.replace("README.html", "index.html") for page in pages}
    own = {
        page for page in pages if not re.search(r"decisions/\d|results/.*(stress|table\d|ood|constants)\.html$", page)
    }
    assert not sorted(page for page in own if f'href="{page}"' not in home and page != "index.html")


def test_the_python_reference_follows_what_the_packages_export(site):
    import cosim
    import gri

    page = (site / "reference/api.html").read_text()
    for package in (gri, cosim):
        missing = [name for name in package.__all__ if f'id="{package.__name__}.{name}"' not in page]
        assert not missing, f"{package.__name__} exports them, docs/reference/api.md does not show them"
