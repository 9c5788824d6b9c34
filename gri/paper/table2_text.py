"""Pieces of the pages of Table 2."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from gri.data.scene_file.schema import header_of
from gri.paper.plots import STYLE, save
from gri.paper.table2 import Job, Row

Results = list[tuple[Job, dict[str, Any]]]

PAPERS = {"GRI": "GRI", "GRI (paper)": "GRI", "NRI": "NRI", "Supervised": "Supervised"}


def by_row(results: Results) -> list[tuple[Row, list[dict[str, Any]]]]:
    """The results of every row, a seed each."""
    names = dict.fromkeys(job.row for job, _ in results)
    return [(row, [result for job, result in results if job.row == row]) for row in names]


def lines(head: list[str], body: list[list[str]]) -> str:
    """A Markdown table."""
    return "\n".join(f"| {' | '.join(line)} |" for line in [head, ["---"] * len(head), *body]) + "\n"


def write_tables(scores: list[dict[str, Any]], curves: list[dict[str, Any]], out: Path) -> list[Path]:
    """The scores and the curves out of distribution as CSV files."""
    files = [out / "table2.csv", out / "table2_ood.csv"]
    for file, rows in zip(files, (scores, curves), strict=True):
        pd.DataFrame(rows).to_csv(file, index=False)
    return files


def write_figures(drawn: Mapping[str, Callable[[Results], Figure]], results: Results, out: Path) -> list[Path]:
    """The figures by name; those of edge frequencies (F6) only where a row infers graphs."""
    graphs = any(result["graphs"] for _, result in results)
    names = [name for name in drawn if graphs or not name.startswith("f6_")]
    with plt.rc_context(STYLE):
        for name in names:
            save(drawn[name](results), out, name)
    return [out / f"{name}.png" for name in names]


def printed_cell(value: tuple[float, float] | None, digits: int) -> str:
    """What the paper prints, if it does."""
    return "–" if value is None else f"{value[0]:.{digits}f} ± {value[1]:.{digits}f}"


def files_of(path: Path) -> str:
    """Names of the recordings that a scene file was cut from."""
    return ", ".join(f["name"] for f in header_of(path).provenance["ngsim"]["files"])
