"""Pieces of the pages of Table 2."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gri.data.scenes_file import header_of
from gri.table2 import Job, Row

PAPERS = {"GRI": "GRI", "GRI (paper)": "GRI", "NRI": "NRI", "Supervised": "Supervised"}


def by_row(results: Sequence[tuple[Job, dict[str, Any]]]) -> list[tuple[Row, list[dict[str, Any]]]]:
    """The results of every row, a seed each."""
    names = dict.fromkeys(job.row for job, _ in results)
    return [(row, [result for job, result in results if job.row == row]) for row in names]


def lines(head: list[str], body: list[list[str]]) -> str:
    """A Markdown table."""
    return "\n".join(f"| {' | '.join(line)} |" for line in [head, ["---"] * len(head), *body]) + "\n"


def printed_cell(value: tuple[float, float] | None, digits: int) -> str:
    """What the paper prints, if it does."""
    return "–" if value is None else f"{value[0]:.{digits}f} ± {value[1]:.{digits}f}"


def files_of(path: Path) -> str:
    """Names of the recordings that a scene file was cut from."""
    return ", ".join(f["name"] for f in header_of(path).provenance["ngsim"]["files"])
