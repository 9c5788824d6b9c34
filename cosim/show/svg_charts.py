"""Charts of a batch as SVG in the text colour of the page, readable on light and dark screens and on paper."""

import io
import re
import zlib
from collections.abc import Sequence
from html import escape
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.batch.group_statistics import BY_NAME, Measure, uninterrupted

INK = "#010203"  # placeholder, replaced by the text colour of the page
LINES: tuple[dict[str, Any], ...] = (
    {"color": "#0072b2", "ls": "-", "marker": "o"},
    {"color": "#d55e00", "ls": "--", "marker": "s"},
    {"color": "#009e73", "ls": ":", "marker": "^"},
    {"color": "#cc79a7", "ls": "-.", "marker": "D"},
    {"color": "#7f7f7f", "ls": (0, (6, 1, 1, 1, 1, 1)), "marker": "X"},
)
"""Of the policies of a chart: markers and line styles tell them apart in grey print."""
STYLE: Any = {
    "font.size": 9, "svg.fonttype": "none", "font.family": "sans-serif", "axes.spines.top": False,
    "axes.spines.right": False, "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": INK, "xtick.color": INK,
    "ytick.color": INK, "axes.titlesize": 9, "legend.frameon": False, "svg.hashsalt": "cosim",
}  # fmt: skip
SIZE = (3.4, 2.8)  # [inches] of a chart; several stand side by side where the page is wide enough


def parts(policies: Sequence[str]) -> list[list[str]]:
    """The policies in parts of as many as there are line styles, with the first one in each."""
    first, others, room = policies[0], policies[1:], len(LINES) - 1
    return [[first, *others[k : k + room]] for k in range(0, max(len(others), 1), room)]


def curves(groups: pd.DataFrame, perturbation: str, unit: str, measures: Sequence[str]) -> str:
    """SVGs of each measure over the intensity of one perturbation, one line per policy with 95 % intervals.

    `unit` is the unit of the intensity.
    """
    part = groups[groups["perturbation"] == perturbation]
    spread = float(np.ptp(part["intensity"])) if len(part) else 0.0
    charts = []
    for policies in parts(list(dict.fromkeys(groups["policy"]))):
        shown = part[part["policy"].isin(policies)]
        for name in measures:
            with matplotlib.rc_context(STYLE):
                figure = Figure(figsize=SIZE, layout="constrained")
                axes = figure.subplots()
                for policy, rows in shown.groupby("policy", sort=False):
                    k = policies.index(str(policy))
                    _draw_curve(axes, rows, BY_NAME[name], LINES[k], label=str(policy), shift=0.012 * spread * k)
                axes.set(
                    xlabel=f"intensity of {perturbation}{f' [{unit}]' if unit else ''}",
                    ylabel=title_with_unit(BY_NAME[name]),
                )
                if BY_NAME[name].share:
                    axes.set_ylim(-4, 104)
                axes.legend(fontsize=8)
                title = f"{title_with_unit(BY_NAME[name])} over the intensity of {perturbation}"
                drawn = ", ".join(str(policy) for policy in dict.fromkeys(shown["policy"]))
                about = (
                    f"Lines with markers, one per policy: {drawn}. The table above has the values over all intensities."
                )
                charts.append(svg(figure, title, about))
    return "".join(charts)


def _draw_curve(
    axes: Axes, rows: pd.DataFrame, measure: Measure, style: dict[str, Any], label: str, shift: float
) -> None:
    """Draw one line; `shift` moves it along x, so that markers of equal policies do not hide each other."""
    rows = rows if measure.every_start else uninterrupted(rows)
    points = [(intensity, measure.estimate(part)) for intensity, part in rows.groupby("intensity")]
    points = [(float(str(intensity)), estimate) for intensity, estimate in points if estimate.n]
    if not points:
        return
    factor = 100 if measure.unit == "share" else 1
    x = [intensity + shift for intensity, _ in points]
    middle, low, high = (factor * np.array([getattr(e, k) for _, e in points]) for k in ("value", "low", "high"))
    axes.errorbar(x, middle, [middle - low, high - middle], ms=4, lw=1.5, capsize=2, label=label, **style)


def distributions(groups: pd.DataFrame, measures: Sequence[str]) -> str:
    """SVGs of cumulative distributions, one line per policy; over nominal runs if there are any."""
    nominal = groups[groups["perturbation"] == "nominal"]
    part = uninterrupted(nominal if len(nominal) else groups)
    charts = []
    for policies in parts(list(dict.fromkeys(groups["policy"]))):
        for measure in (BY_NAME[name] for name in measures):
            with matplotlib.rc_context(STYLE):
                figure = Figure(figsize=SIZE, layout="constrained")
                axes, medians = figure.subplots(), []
                for k, policy in enumerate(policies):
                    values = np.sort(measure.values(part[part["policy"] == policy]))
                    if len(values):
                        share = 100 * np.arange(1, len(values) + 1) / len(values)
                        style = {name: value for name, value in LINES[k].items() if name != "marker"}
                        axes.step(values, share, where="post", lw=1.6, label=policy, **style)
                        medians.append(f"{policy} {np.median(values):.2f}")
                axes.set(xlabel=title_with_unit(measure), ylabel="share of groups [%]", ylim=(0, 102))
                axes.legend(fontsize=8)
                about = f"One line per policy. Medians: {', '.join(medians)}."
                charts.append(svg(figure, f"Cumulative distribution of {title_with_unit(measure)}", about))
    return "".join(charts)


def title_with_unit(measure: Measure) -> str:
    """Title and unit of a measure, e.g. "minimum gap [m]"."""
    return f"{measure.title} [{'%' if measure.unit == 'share' else measure.unit}]"


def svg(figure: Figure, title: str, about: str) -> str:
    """The figure as an SVG element without background, in the text colour of the page, with a text alternative."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    text = stream.getvalue().replace(INK, "currentColor")
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    head, _, rest = text[text.index("<svg") :].partition(">")
    name = f"chart-{zlib.crc32(title.encode() + rest.encode()):08x}"
    return (
        f'{head} role="img" aria-labelledby="{name}-title {name}-about">'
        f'<title id="{name}-title">{escape(title)}</title>'
        f'<desc id="{name}-about">{escape(about)}</desc>{rest}'
    )
