"""Tables from data: lines, columns and the data frame with the scores of every row and seed.

A line of a table has a label and a part of the frame. A column has a heading and says which scores of that part it
shows. `score_columns` are the columns that Tables I to III share.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Literal

import pandas as pd

from gri.evaluation.recorded_scores import pooled_rate
from gri.paper.rows import Row, Scenario, published_row
from gri.table import markdown_table

NOTHING = "–"
UNITS = {"x": "m", "y": "m", "v": "m/s"}


@dataclass(frozen=True)
class Line:
    """One line of a table."""

    label: str
    scores: pd.DataFrame
    """All seeds of the row."""
    row: Row | None = None
    """None for references: the oracle, the empty graph, recorded driving."""


@dataclass(frozen=True)
class Column:
    """One column of a table."""

    heading: str
    cell: Callable[[Line], str]


def table(columns: Sequence[Column], lines: Iterable[Line], first: str = "model") -> str:
    """A Markdown table, whose first column has the labels of the lines."""
    cells = [[line.label, *[column.cell(line) for column in columns]] for line in lines]
    return markdown_table([first, *[column.heading for column in columns]], cells)


def lines_of(rows: Sequence[Row], scores: pd.DataFrame, label: str = "{}") -> list[Line]:
    """A line for each row that the frame has scores of."""
    parts = [(row, scores[scores["row"] == row.name]) for row in rows]
    return [Line(label.format(row.name), part, row) for row, part in parts if len(part)]


def column(
    heading: str,
    metric: str | float | Callable[[Row | None], str],
    digits: int,
    factor: float = 1.0,
    *,
    over_seeds: Literal["mean", "range", "lowest"] = "mean",
    width: str | None = None,
    key: str = "metric",
    value: str = "mean",
) -> Column:
    """A column of the `value` in those lines of the frame whose `key` is the metric, which may depend on the row.

    Cells have the mean over seeds, or `mean ± mean width [lowest, highest]`, or the lowest value. References have the
    mean.
    """

    def cell(line: Line) -> str:
        name = metric(line.row) if callable(metric) else metric
        chosen = line.scores[line.scores[key] == name]
        if not len(chosen):
            return NOTHING
        mean, low, high = (f"{factor * f(chosen[value]):.{digits}f}" for f in (fmean, min, max))
        if over_seeds == "lowest":
            return low
        if over_seeds == "mean" or line.row is None:
            return mean
        return f"{mean}{f' ± {factor * fmean(chosen[width]):.{digits}f}' if width else ''} [{low}, {high}]"

    return Column(heading, cell)


def published_column(scenario: Scenario, score: str, digits: int) -> Column:
    """The paper's figure for the row."""

    def cell(line: Line) -> str:
        figure = getattr(published_row(scenario, line.row), score, None)
        return NOTHING if figure is None else f"{figure[0]:.{digits}f} ± {figure[1]:.{digits}f}"

    return Column("paper", cell)


SEEDS = Column("seeds", lambda line: NOTHING if line.row is None else str(line.scores["seed"].nunique()))
CPU_SECONDS = column("CPU s/seed", "training_cpu_seconds", 0)


def score_columns(
    scenario: Scenario, digits: int, published_digits: int, percent_digits: int, width: str = "std"
) -> list[Column]:
    """Errors and accuracy, each beside the paper's figure: what Tables I to III have in common."""
    columns = []
    for feature in scenario.features:
        heading, metric = f"RMSE_{feature} [{UNITS[feature]}]", f"rmse_{feature}"
        columns.append(column(heading, metric, digits, over_seeds="range", width=width))
        columns.append(published_column(scenario, feature, published_digits))
    accuracy = column("accuracy [%]", _accuracy, percent_digits, 100.0, over_seeds="range", width=width)
    return [*columns, accuracy, published_column(scenario, "accuracy", percent_digits)]


def _accuracy(row: Row | None) -> str:
    """Types without a defined meaning are renamed before they are compared with the true ones."""
    return "accuracy" if row is None or row.defined_types else "accuracy_renamed"


def success_column(ratio: float, digits: int) -> Column:
    """Success rate ± half the 95 % interval over the scenes of one seed (collision rate) [%] at a ratio δ."""

    def cell(line: Line) -> str:
        points = line.scores[line.scores["ratio"] == ratio]
        success = fmean(points["success"])
        half_width = pooled_rate(success, int(points["scenes"].iloc[0])).half_width
        collision = fmean(points["collision"])
        return f"{100 * success:.{digits}f} ± {100 * half_width:.{digits}f} ({100 * collision:.{digits}f})"

    return Column(f"δ {ratio:g}", cell)
