"""What documents, docstrings and comments name exists: links, paths, modules, tests; and Markdown tables are whole."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
OLD_NAMES = ROOT / "docs/decisions/016-rooms-and-names.md"  # a list of names that are gone
PAGES = sorted({*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("sumo_nets/*/*.md")} - {OLD_NAMES})
SOURCES = sorted([*ROOT.glob("gri/**/*.py"), *ROOT.glob("cosim/**/*.py")])

ENVIRONMENT = r"(?!cosim/\w+-v\d)"  # names of environments, such as cosim/us101_merge-v1, are no paths
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^()\s]+)\)")
PATH = re.compile(
    ENVIRONMENT + r"(?<![\w./-])(?:gri|cosim|tests|docs|scenarios|sumo_nets|benchmarks|\.ci)/[\w./*-]*[\w*/]"
)
MODULE = re.compile(r"(?<![\w./-])(?:gri|cosim)(?:\.[A-Za-z_]\w*)+")
FILE = re.compile(r"(?<![\w./*<-])\w+\.py\b(?:::\w+)?")
NOT_MODULES = {"gri.scenes"}  # a key of Parquet metadata
TEST = re.compile(r"(?<!\w)::(test_\w+)")  # a test of the file named before
WRITTEN = {"time_gap.py", "read.py", "file.py", "my_policy.py", "policy.py"}  # files that a reader writes


def names(paths: list[Path]) -> list[str]:
    return [str(path.relative_to(ROOT)) for path in paths]


def documentation(source: str) -> str:
    """The docstrings and comments of a Python file."""
    comments = [t.string for t in tokenize.generate_tokens(io.StringIO(source).readline) if t.type == tokenize.COMMENT]
    holders = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    strings = [ast.get_docstring(node) or "" for node in ast.walk(ast.parse(source)) if isinstance(node, holders)]
    return "\n".join([*comments, *strings])


@cache
def defined(file: Path) -> frozenset[str]:
    """The names that a module defines or imports at its top level."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        match node:
            case ast.ClassDef() | ast.FunctionDef() | ast.AsyncFunctionDef():
                found.add(node.name)
            case ast.ImportFrom() | ast.Import():
                found |= {alias.asname or alias.name for alias in node.names}
            case ast.Name(ctx=ast.Store()):
                found.add(node.id)
    return frozenset(found)


def module_exists(dotted: str) -> bool:
    """Whether the longest prefix that is a module defines the next name."""
    parts = dotted.split(".")
    for count in range(len(parts), 0, -1):
        place = ROOT.joinpath(*parts[:count])
        file = place.with_suffix(".py") if place.with_suffix(".py").is_file() else place / "__init__.py"
        if file.is_file():
            return count == len(parts) or parts[count] in defined(file) or parts[count].startswith("__")
    return False


def path_exists(path: str) -> bool:
    """A file or folder, a pattern, or a decision note without its title ("docs/decisions/003")."""
    return (ROOT / path).exists() or any(ROOT.glob(path if "*" in path else f"{path}-*"))


def test_exists(name: str) -> bool:
    file, _, function = name.partition("::")
    places = [path for path in ROOT.glob(f"**/{file}") if ".venv" not in path.parts]
    return any(not function or f"def {function}(" in path.read_text() for path in places)


test_exists.__test__ = False  # type: ignore[attr-defined]


def dead(text: str) -> Iterator[str]:
    for path in PATH.findall(text):
        if not path.rpartition("/")[2].isupper() and not path_exists(path.rstrip("/.")):
            yield path
    for dotted in MODULE.findall(text):
        written_as_file = dotted.endswith((".py", ".yaml", ".md"))
        if dotted not in NOT_MODULES and not written_as_file and not module_exists(dotted):
            yield dotted
    for name in FILE.findall(text):
        if name not in WRITTEN and not test_exists(name):
            yield name
    tests = "\n".join(path.read_text() for path in ROOT.glob("tests/**/*.py"))
    yield from (f"::{name}" for name in TEST.findall(text) if f"def {name}(" not in tests)


def slugs(page: Path) -> set[str]:
    """Anchors of the headings of a page."""
    heads = re.findall(r"^#{1,6} +(.*)$", FENCE.sub("", page.read_text()), re.MULTILINE)
    plain = (re.sub(r"[^\w\s-]", "", head.strip().lower()) for head in heads)
    return {re.sub(r"\s", "-", head) for head in plain} | {re.sub(r"[\s-]+", "-", head) for head in plain}


@pytest.mark.parametrize("name", names(PAGES))
def test_links_of_pages_lead_somewhere(name):
    page = ROOT / name
    for link in LINK.findall(FENCE.sub("", page.read_text())):
        if link.startswith(("https://", "http://")):
            continue
        target, _, anchor = link.partition("#")
        place = page.parent / target if target else page
        assert place.exists(), f"{name} links to {link}"
        if anchor and place.suffix == ".md":
            assert anchor in slugs(place), f"{name} links to {link}, which has no such section"


@pytest.mark.parametrize("name", names(PAGES))
def test_pages_name_only_what_exists(name):
    assert not sorted(set(dead((ROOT / name).read_text())))


@pytest.mark.parametrize("name", names(SOURCES))
def test_docstrings_and_comments_name_only_what_exists(name):
    assert not sorted(set(dead(documentation((ROOT / name).read_text()))))


def cells(line: str) -> int:
    return len(re.sub(r"\\\|", "", line.strip()).strip("|").split("|"))


@pytest.mark.parametrize("name", names(PAGES))
def test_tables_have_as_many_cells_in_every_row(name):
    lines = FENCE.sub("", (ROOT / name).read_text()).splitlines()
    for k, line in enumerate(lines[1:], 1):
        if re.fullmatch(r"\|[\s:|-]+\|", line) and "-" in line and not re.fullmatch(r"\|[\s:|-]+\|", lines[k - 1]):
            wanted = cells(line)
            assert lines[k - 1].startswith("|"), f"{name}: a rule without a header: {line}"
            for row in [lines[k - 1], *iter_rows(lines[k + 1 :])]:
                assert cells(row) == wanted, f"{name}: {cells(row)} cells, the rule has {wanted}: {row[:120]}"


def iter_rows(lines: list[str]) -> Iterator[str]:
    for line in lines:
        if not line.startswith("|"):
            return
        yield line
