import numpy as np
import pandas as pd
from matplotlib import pyplot as plt

from gri.paper.figures import success_curves
from gri.paper.rows import SCENARIOS


def test_synthetic_curves_have_a_titled_panel_for_each_driver_of_vehicle_1():
    point = {"row": "GRI", "seed": 0, "success": 0.5, "success_half_width": 0.1}
    curves = pd.DataFrame(
        [point | {"front": f, "headway": x} for f in ("constant_speed", "policy") for x in (4.0, 0.0)]
    )
    figure = success_curves(SCENARIOS[0], curves)
    assert [axis.get_title() for axis in figure.axes] == [
        "vehicle 1 at constant speed",
        "vehicle 1 driven by the policy",
    ]
    assert figure.axes[0].xaxis_inverted()
    plt.close(figure)


def test_recorded_lane_changes_have_curves_of_success_and_of_collisions():
    points = [{"row": "GRI", "seed": 0, "ratio": r, "success": 0.5, "collision": 0.25, "scenes": 8} for r in (0.0, 1.0)]
    figure = success_curves(SCENARIOS[-1], pd.DataFrame(points))
    assert [axis.get_ylabel() for axis in figure.axes] == ["success rate", "collision rate"]
    assert [np.asarray(axis.lines[0].get_ydata()).tolist() for axis in figure.axes] == [[0.5, 0.5], [0.25, 0.25]]
    plt.close(figure)
