import numpy as np
import pandas as pd
from matplotlib import pyplot as plt

from gri.paper.figures import success_curves, success_figures
from gri.paper.plots import MOST_CURVES, panels, styles
from gri.paper.rows import SCENARIOS


def test_synthetic_curves_have_a_titled_panel_for_each_driver_of_vehicle_1():
    point = {"row": "GRI", "seed": 0, "success": 0.5, "success_half_width": 0.1}
    curves = pd.DataFrame(
        [point | {"front": f, "headway": x} for f in ("constant_speed", "policy") for x in (4.0, 0.0)]
    )
    figure = success_curves(SCENARIOS[0], curves, ["GRI"])
    assert [axis.get_title() for axis in figure.axes] == [
        "vehicle 1 at constant speed",
        "vehicle 1 driven by the policy",
    ]
    assert figure.axes[0].xaxis_inverted()
    plt.close(figure)


def test_recorded_lane_changes_have_curves_of_success_and_of_collisions():
    points = [{"row": "GRI", "seed": 0, "ratio": r, "success": 0.5, "collision": 0.25, "scenes": 8} for r in (0.0, 1.0)]
    figure = success_curves(SCENARIOS[-1], pd.DataFrame(points), ["GRI"])
    assert [axis.get_ylabel() for axis in figure.axes] == ["success rate", "collision rate"]
    assert [np.asarray(axis.lines[0].get_ydata()).tolist() for axis in figure.axes] == [[0.5, 0.5], [0.25, 0.25]]
    plt.close(figure)


def test_no_panel_has_more_curves_than_grey_print_can_tell_apart():
    rows = ["oracle", *(row.name for row in SCENARIOS[0].rows)]
    assert len(rows) > MOST_CURVES
    points = [
        {"row": row, "seed": 0, "front": "policy", "headway": x, "success": 0.5, "success_half_width": 0.1}
        for row in rows
        for x in (4.0, 0.0)
    ]
    figures = dict(success_figures("f8", SCENARIOS[0], pd.DataFrame(points)))
    shown = set()
    for figure in figures.values():
        for axis in figure.axes:
            names = [str(curve.get_label()) for curve in axis.lines]
            assert len(names) <= MOST_CURVES
            assert len({curve.get_marker() for curve in axis.lines}) == len(names)
            shown |= set(names)
        plt.close(figure)
    assert shown == set(rows)
    assert list(figures)[:2] == ["f8", "f8_2"]


def test_rows_that_share_a_panel_differ_in_marker_and_line_style():
    for scenario in SCENARIOS:
        rows = ["oracle", *(row.name for row in scenario.rows)]
        for part in panels(rows, ["oracle", "GRI"]):
            drawn = styles(part).values()
            assert len({style["marker"] for style in drawn}) == len({str(style["ls"]) for style in drawn}) == len(part)
