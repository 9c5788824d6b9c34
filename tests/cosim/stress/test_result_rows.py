"""The comparison of broken-up groups with the rows of SUMO, on rows made by hand."""

import numpy as np
import pandas as pd

from cosim.stress.result_rows import compared_with_sumo


def row(policy: str, cause: str = "", intruders: str = "", entries: str = "", **changes):
    base = {"seed": 1, "start": "a b c", "perturbation": "latency", "intensity": 0.4, "policy": policy}
    return base | {"broken_up_by": cause, "intruders": intruders, "lane_entries": entries} | changes


def causes(*rows) -> list[str]:
    return compared_with_sumo(pd.DataFrame(rows))["broken_up_by"].tolist()


def test_a_cut_in_that_sumo_meets_as_well_is_by_others():
    cut_in = row("gri", "unknown", "x.1@10.20")
    assert causes(cut_in, row("sumo", entries="y.1@9.00 x.1@11.20")) == ["others", ""]
    assert causes(cut_in, row("sumo", entries="x.1@11.40")) == ["unknown", ""], "more than 1 s later"
    assert causes(cut_in, row("sumo", entries="x.10@10.20")) == ["unknown", ""], "another vehicle"


def test_only_the_same_start_in_the_same_cell_is_the_counterpart():
    cut_in, left = row("gri", "unknown", "x@10.20"), {"entries": "x@10.20"}
    assert causes(cut_in) == ["unknown"], "SUMO is not among the policies"
    for other in ({"start": "a b d"}, {"seed": 2}, {"intensity": 0.6}, {"perturbation": "dropout"}):
        assert causes(cut_in, row("sumo", **left, **other)) == ["unknown", ""]


def test_undisturbed_cells_have_no_intensity_and_infeasible_starts_no_entries():
    rows = [
        row("gri", "unknown", "x@10.20", perturbation="nominal", intensity=np.nan),
        row("sumo", "unknown", "x@10.20", entries="x@10.20", perturbation="nominal", intensity=np.nan),
        row("gri", start="d e f") | dict.fromkeys(["broken_up_by", "intruders", "lane_entries"]),
        row("sumo", start="d e f") | dict.fromkeys(["broken_up_by", "intruders", "lane_entries"]),
    ]
    assert causes(*rows)[:2] == ["others", "others"]


def test_known_causes_stay():
    assert causes(row("gri", "policy"), row("sumo", entries="x@10.20")) == ["policy", ""]
