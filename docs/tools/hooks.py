"""Hooks of the documentation site: pages from outside docs/, and links that lead out of it.

Pages must read well in the repository as well as on the site. So they link to files of the repository by relative
paths. On the site such a link leads to the page where there is one; else only its text is shown.
"""

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
INCLUDED = (
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    *sorted(str(path.relative_to(ROOT)) for path in ROOT.glob("sumo_nets/*/*") if path.suffix in (".md", ".png")),
)
OPTIONAL = ("notebook.ipynb", "own-policy.md")  # have an entry in the navigation as soon as they exist
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s#]+)(#[^()\s]*)?\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    missing = {name for name in OPTIONAL if not Path(config.docs_dir, name).is_file()}
    config.nav = _without(config.nav, missing)
    return config


def _without(entries: Any, missing: set[str]) -> Any:
    """The navigation without the entries of missing files."""
    if isinstance(entries, list):
        kept = [_without(entry, missing) for entry in entries]
        return [entry for entry in kept if entry]
    if isinstance(entries, dict):
        return {title: rest for title, entry in entries.items() if (rest := _without(entry, missing))}
    return None if entries in missing else entries


def on_files(files: Files, config: MkDocsConfig) -> Files:
    for name in INCLUDED:
        files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Rewrite relative links, outside of code, for the place that their page has on the site."""
    known = {file.src_uri for file in files}
    here = page.file.src_uri
    parts = re.split(r"(^```.*?^```[^\n]*$)", markdown, flags=re.MULTILINE | re.DOTALL)
    return "".join(
        part if part.startswith("```") else LINK.sub(lambda link: _link(link, here, known), part) for part in parts
    )


def _link(link: re.Match[str], here: str, known: set[str]) -> str:
    mark, text, target, anchor = link[1], link[2], link[3], link[4] or ""
    if ":" in target or target.startswith("/"):
        return link[0]
    in_repository = here if here in INCLUDED else f"docs/{here}"
    meant = posixpath.normpath(posixpath.join(posixpath.dirname(in_repository), target))
    place = meant.removeprefix("docs/") if meant.startswith("docs/") else meant
    for found in (place, f"{place}/README.md", f"{place}/index.md"):
        if found in known and (meant.startswith("docs/") or found in INCLUDED):
            return f"{mark}[{text}]({posixpath.relpath(found, posixpath.dirname(here) or '.')}{anchor})"
    return text if (ROOT / meant).exists() and not meant.startswith("docs/") else link[0]
