"""A table as a value, and its writers: text for a terminal, Markdown, CSV and JSON.

A table has two contents. `lines` are texts for reading, `records` are the numbers behind them in full precision.
`terminal_text` never writes a line that is longer than the terminal is wide, and never cuts a cell: it wraps cells, or
swaps rows and columns. Begin with `Table`; `gri.terminal.show_tables` prints.
"""

import csv
import io
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import Any, Literal

TableFormat = Literal["table", "md", "csv", "json"]
BREAKS = re.compile(r"[ \n]|(?<=[A-Za-z]{2}-)(?=[A-Za-z]{2})")  # where `textwrap` breaks a line
GAP = "  "  # between two columns
NBSP = "\N{NO-BREAK SPACE}"
"""A space at which no cell is wrapped, as inside an interval; it is written as a space."""


@dataclass(frozen=True)
class Table:
    """A table for reading, with the numbers behind it."""

    name: str
    """A short name: the key of the table in JSON."""
    head: Sequence[str]
    """One heading per column, with units."""
    lines: Sequence[Sequence[str]]
    """One text per column in each line; a line break in a text is kept."""
    records: Sequence[Mapping[Any, Any]]
    """The numbers of CSV and JSON, unrounded; not necessarily one per line."""
    title: str = ""
    note: str = ""
    labels: int = 1
    """How many columns name a line; they are on the left, the others are values."""

    def __post_init__(self) -> None:
        for line in self.lines:
            if len(line) != len(self.head):
                raise ValueError(f"got {len(line)} cells in line {list(line)}, wanted {len(self.head)}")


def terminal_text(table: Table, width: int) -> str:
    """The table in lines of at most `width` characters.

    Where its lines are too long, either cells are wrapped at spaces, or the headings become the first column and the
    lines become columns, as many side by side as fit: whichever takes fewer lines. A word is broken only where it is
    longer than its column in both layouts.
    """
    cells = [list(table.head), *map(list, table.lines)]
    body = _grid(cells, table.labels, width, fold=False)
    if len(body) != sum(max(cell.count("\n") for cell in line) + 1 for line in cells) + 1:  # a cell was wrapped
        swapped = _swapped(cells, table.labels, width) or _grid(cells, table.labels, width)
        body = swapped if not body or len(swapped) < len(body) else body
    title, note = (wrap(text, width) for text in (table.title, table.note))
    return "\n".join([*title, *body, *note]).replace(NBSP, " ")


def _swapped(cells: Sequence[Sequence[str]], labels: int, width: int) -> list[str]:
    """The layout with a column per line, in blocks of as many columns as fit side by side.

    A block ends where a label other than the last one changes, so that lines that differ in the last one, such as the
    policies under one perturbation, stand side by side.
    """
    (head, *lines), shown = cells, list[str]()
    while lines:
        count = len(lines)
        while not (block := _grid(_turned(head, lines[:count], labels), 1, width, fold=count == 1)):
            count -= 1
        if whole := _whole_parts([line[: labels - 1] for line in lines[: count + 1]], count):
            block = _grid(_turned(head, lines[: (count := whole)], labels), 1, width)
        shown += ([""] if shown else []) + block
        lines = lines[count:]
    return shown


def _whole_parts(names: Sequence[Sequence[str]], count: int) -> int:
    """The most lines, up to `count`, that end where the names of the lines change; 0 where they do not change."""
    return next((k for k in range(count, 0, -1) if k < len(names) and names[k] != names[k - 1]), 0)


def _turned(head: Sequence[str], lines: Sequence[Sequence[str]], labels: int) -> list[list[str]]:
    """Rows and columns swapped; the labels of a line become one heading, above each other."""
    names = ["\n".join(line[:labels]) for line in lines]
    values = [[head[k], *(line[k] for line in lines)] for k in range(labels, len(head))]
    return [["\n".join(head[:labels]), *names], *values]


def _grid(cells: Sequence[Sequence[str]], labels: int, width: int, *, fold: bool = True) -> list[str]:
    """A line per row of cells, the first one as heading; empty if the widest words do not fit and `fold` is False."""
    columns = list(zip(*cells, strict=True))
    wanted = [max(map(len, "\n".join(column).split("\n"))) for column in columns]
    least = [max(map(len, BREAKS.split("\n".join(column)))) for column in columns]
    room = width - len(GAP) * (len(columns) - 1)
    if sum(least) > room and (not fold or room < len(columns)):
        return []
    if sum(least) > room:
        least = [min(word, max(1, room // len(columns))) for word in least]
    while sum(wanted) > room:
        widest = max((k for k in range(len(wanted)) if wanted[k] > least[k]), key=lambda k: wanted[k])
        wanted[widest] -= 1
    rows = [_row(line, wanted, labels) for line in cells]
    rule = GAP.join("─" * column for column in wanted)
    return [*rows[0], rule, *(text for row in rows[1:] for text in row)]


def _row(cells: Sequence[str], widths: Sequence[int], labels: int) -> list[str]:
    """The text lines of one row; labels are aligned on the left, values on the right."""
    parts = [
        [piece for line in cell.split("\n") for piece in (_wrapped(line, width) or [""])]
        for cell, width in zip(cells, widths, strict=True)
    ]
    height = max(map(len, parts))
    filled = [part + [""] * (height - len(part)) for part in parts]
    texts = [
        [piece.ljust(width) if k < labels else piece.rjust(width) for piece in part]
        for k, (part, width) in enumerate(zip(filled, widths, strict=True))
    ]
    return [GAP.join(line).rstrip() for line in zip(*texts, strict=True)]


def _wrapped(line: str, width: int) -> list[str]:
    """The pieces of a line, none for an empty one. Its indentation is kept: it marks a part of the row above."""
    indent = " " * min(len(line) - len(line.lstrip()), width // 2)
    return wrap(line.strip(), max(width, 1), initial_indent=indent, subsequent_indent=indent)


def markdown_text(table: Table) -> str:
    """The table in Markdown, with its title above and its note below."""
    title = f"**{table.title}**\n\n" if table.title else ""
    note = f"\n{table.note}\n" if table.note else ""
    return title + markdown_table(table.head, table.lines) + note


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
    lines = (" ".join(line.split()) for line in text.replace("|", "\\|").strip().split("\n"))
    return "<br>".join(lines)


def csv_text(table: Table) -> str:
    """The records as CSV with a header; what is missing is empty."""
    names = list(dict.fromkeys(name for record in table.records for name in record))
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: "" if _missing(value) else value for name, value in r.items()} for r in table.records)
    return text.getvalue()


def json_text(tables: Sequence[Table]) -> str:
    """An object with the records of each table under its name; what is missing or not finite is null."""
    content = {table.name: [{k: _finite(v) for k, v in r.items()} for r in table.records] for table in tables}
    return json.dumps(content, indent=2, ensure_ascii=False, default=_plain, allow_nan=False) + "\n"


def _missing(value: Any) -> bool:
    return value is None or (isinstance(value, float) and math.isnan(value))


def _finite(value: Any) -> Any:
    value = _plain(value) if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _plain(value: Any) -> Any:
    """A number of numpy as a number of Python."""
    return value.item() if hasattr(value, "item") else str(value)


WRITERS: Mapping[TableFormat, Callable[[Sequence[Table]], str]] = {
    "md": lambda tables: "\n".join(map(markdown_text, tables)),
    "csv": lambda tables: "\n".join(map(csv_text, tables)),
    "json": json_text,
}
"""The writers for files and pipes; a terminal has `terminal_text`."""
