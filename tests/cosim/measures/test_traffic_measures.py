"""Measures of traffic from samples once a second, by hand."""

import numpy as np
import pandas as pd
import pytest

from cosim.measures.traffic_measures import (
    CELL_LENGTH,
    CELL_TIME,
    cell_speeds,
    figures,
    merge_figures,
    ordered,
    pattern_figures,
    space_time,
    vehicles_table,
    wave_speed,
)

NO_BRAKING = pd.DataFrame({"vehicle": ["a"], "brakings_3": [2], "brakings_4.5": [0]})


def way(name: str, v: list[float], x: float = 0.0, lane: list[int] | None = None, begin: float = 0.0) -> pd.DataFrame:
    """The samples of one vehicle from `x` on."""
    n = len(v)
    return pd.DataFrame(
        {
            "time": begin + np.arange(1, n + 1.0),
            "vehicle": name,
            "driver": "sumo",
            "lane": lane or [1] * n,
            "x": x + np.cumsum([0, *v[:-1]]),
            "v": v,
            "ttc": np.inf,
            "fuel": 1000.0,
            "co2": 3000.0,
            "nox": 1.0,
            "pmx": 0.1,
        }
    )


def test_a_vehicle_has_its_stops_lane_changes_and_travel_time() -> None:
    samples = way("a", [20.0, 20.0, 0.0, 0.0, 20.0, 20.0, 20.0], lane=[1, 2, 2, 2, 2, 3, 3])
    samples.loc[1, "ttc"] = 1.0
    table = vehicles_table(ordered(pd.concat([samples, way("b", [10.0] * 3)])), NO_BRAKING, 100.0)
    a, b = table.to_dict("records")
    assert (a["lane_changes"], a["stops"], a["standing"], a["tet"], a["tit"]) == (2, 1, 2, 1, 0.5)
    assert a["travel_time"] == pytest.approx(6 * 100 / 80)
    assert np.isnan(b["travel_time"])  # it is still on its way
    assert (a["brakings_3"], b["brakings_3"]) == (2, 0)


def test_flow_density_and_speed_are_edies_and_rates_are_per_distance() -> None:
    samples = ordered(pd.concat([way("a", [10.0] * 10), way("b", [20.0] * 10)]))
    vehicles = vehicles_table(samples, NO_BRAKING, 1000.0)
    found = figures(samples, vehicles, 1000.0, 10.0, {"contacts": 3})
    assert found["flow"] == pytest.approx(3600 * 300 / (1000 * 10))
    assert found["density"] == pytest.approx(2.0)
    assert found["mean_speed"] == 15.0
    assert found["flow"] == pytest.approx(3.6 * found["density"] * found["mean_speed"])
    assert found["brakings_3"] == pytest.approx(2 / 0.3)
    assert found["fuel"] == pytest.approx(20 / 0.3)
    assert found["contacts"] == 3.0


def waves(speed: float, noise: float = 0.0) -> pd.DataFrame:
    """Speeds by time and place with a wave that moves upstream at this speed [m/s]."""
    t, x = np.arange(0, 900, CELL_TIME)[:, None], np.arange(0, 640, CELL_LENGTH)[None]
    v = 10 + 4 * np.sin(2 * np.pi * (t + x / speed) / 120)
    return pd.DataFrame(v + noise * np.random.default_rng(0).normal(size=v.shape))


@pytest.mark.parametrize("speed", [3.5, 5.0, 7.0])
def test_the_speed_of_waves_is_found_and_noise_has_none(speed: float) -> None:
    assert wave_speed(waves(speed, noise=1.0)) == pytest.approx(-speed, abs=0.6)
    assert np.isnan(wave_speed(waves(speed) * 0 + waves(speed, 100.0) - waves(speed)))


def test_cells_hold_every_second_and_metre() -> None:
    samples = ordered(pd.concat([way("a", [10.0] * 30), way("b", [0.0] * 30, x=55.0)]))
    cells = space_time(samples, 320.0, 0.0, 30.0)
    assert len(cells) == 3 * 16
    assert cells["seconds"].sum() == 60
    assert cells["distance"].sum() == 300
    assert cells["standing"].sum() == 30
    assert cell_speeds(cells).loc[20.0, 40.0] == 0.0
    assert pattern_figures(cells)["slow_cells"] == pytest.approx(3 / (cells["seconds"] > 0).sum())


def test_capacity_drops_where_the_flow_of_congested_minutes_is_lower() -> None:
    def minute(k: int, v: float, gap: float) -> list[pd.DataFrame]:
        count = int(60 * v / gap)
        return [way(f"{k}.{j}", [v] * int(500 / v), begin=60.0 * k + j * gap / v) for j in range(count)]

    free = [part for k in range(8) for part in minute(k, 25.0, 50.0)]
    jam = [part for k in range(10, 18) for part in minute(k, 10.0, 25.0)]
    samples = pd.concat([*free, *jam])
    found = merge_figures(samples, (200.0, 300.0), 0.0, 18 * 60.0, 500.0)
    assert found["capacity_drop"] == pytest.approx(1 - (10 / 25) / (25 / 50), abs=0.08)
    assert np.isnan(merge_figures(pd.concat(free), (200.0, 300.0), 0.0, 480.0, 500.0)["capacity_drop"])
    assert np.isnan(merge_figures(samples, None, 0.0, 480.0, 500.0)["merge_flow"])
