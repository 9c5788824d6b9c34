"""The writer of all Markdown tables."""

from collections.abc import Sequence


def markdown_table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A Markdown table that ends with a newline. Pipes and line breaks in cells do not break it.

    Errors: `ValueError` where a line has more or fewer cells than the header.
    """
    for line in lines:
        if len(line) != len(header):
            raise ValueError(f"got {len(line)} cells in line {list(line)}, wanted {len(header)}: {list(header)}")
    every = [header, ["---"] * len(header), *lines]
    return "".join(f"| {' | '.join(map(_cell, line))} |\n" for line in every)


def _cell(text: str) -> str:
    return " ".join(text.replace("\\", "\\\\").replace("|", "\\|").split())
