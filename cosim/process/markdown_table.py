"""Tables in Markdown."""

from collections.abc import Iterable, Iterator, Sequence


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """The lines of a Markdown table. Pipes in cells are escaped, because a bare one would begin another cell."""
    yield _line(head)
    yield _line(["---"] * len(head))
    for row in rows:
        assert len(row) == len(head), f"got {len(row)} cells, wanted {len(head)}: {row}"
        yield _line(row)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
