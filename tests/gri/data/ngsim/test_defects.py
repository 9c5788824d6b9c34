from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gri.data.ngsim.defects import Quality, Tracks, clean
from gri.data.ngsim.recordings import recordings
from gri.errors import InputError
from tests.gri.data.ngsim.conftest import FOOT, platoon

Write = Callable[[pd.DataFrame], Path]


def cleaned(table: pd.DataFrame, write: Write) -> tuple[Tracks, Quality]:
    (recording,) = recordings(write(table))
    return clean(recording)


def found(quality: Quality) -> dict[str, int]:
    return {name: count for name, count in quality.defects.items() if count}


def test_clean_traffic_has_no_defects_and_si_units(text_file: Write):
    tracks, quality = cleaned(platoon(), text_file)
    assert found(quality) == {}
    assert (quality.rows, quality.vehicles, quality.tracks, quality.seconds) == (240, 3, 3, 8.0)
    assert tracks.x[0] == pytest.approx(53.0 * FOOT)
    assert tracks.y[0] == pytest.approx(-18.0 * FOOT)  # to the left is positive
    assert tracks.length[0] == pytest.approx(15.0 * FOOT)


def test_planted_defects_are_each_found(text_file: Write):
    table = platoon(4)
    table.loc[[10, 11], "v_Acc"] = 11.2
    table.loc[12, "v_Acc"] = -30.0
    table.loc[table["Vehicle_ID"] == 2, "v_Length"] = 45.0
    table.loc[20:23, "Lane_ID"] = 3
    backwards = table.index[(table["Vehicle_ID"] == 4) & (table["Frame_ID"] == 70)]
    table.loc[backwards, "Local_Y"] -= 4.5  # a step of -1.5 ft, then one of 7.5 ft
    table = pd.concat([table, table.iloc[[30, 31, 32]], table.iloc[[40]].assign(Local_Y=99.0)])
    quality = cleaned(table, text_file)[1]
    assert found(quality) == {
        "repeated rows": 3,
        "rows that contradict another of the same frame": 1,
        "accelerations cut off at 11.2 ft/s2": 2,
        "accelerations above 8 m/s2": 1,
        "steps backwards": 1,
        "rows of cars longer than 12 m": 80,
        "lanes left again within 1 s": 1,
    }


def test_short_gaps_are_filled_and_long_ones_cut(text_file: Write):
    table = platoon(1)
    short, long = table["Frame_ID"].between(20, 22), table["Frame_ID"].between(40, 59)
    tracks, quality = cleaned(table[~short & ~long], text_file)
    assert found(quality) == {"gaps filled": 1, "gaps left, track cut": 1}
    np.testing.assert_array_equal(tracks.frame, [*range(1, 40), *range(60, 81)])
    np.testing.assert_array_equal(np.bincount(tracks.track), [39, 21])
    np.testing.assert_allclose(tracks.x, (50 + 3.0 * tracks.frame) * FOOT, rtol=1e-6)


def test_swapped_numbers_and_jumps_cut_the_tracks(text_file: Write):
    table = platoon(3)
    late = table["Frame_ID"] > 40
    swapped = table["Vehicle_ID"].replace({1: 2, 2: 1})
    table["Vehicle_ID"] = table["Vehicle_ID"].where(~late, swapped)
    table.loc[(table["Vehicle_ID"] == 3) & late, "Local_X"] += 12.0
    tracks, quality = cleaned(table, text_file)
    assert found(quality) == {"numbers swapped with another vehicle": 2, "other jumps": 1}
    assert quality.tracks == 6
    same = np.diff(tracks.track) == 0
    assert np.abs(np.diff(tracks.x)[same]).max() < 1.0  # no track holds a jump


def test_vehicles_on_top_of_each_other_are_counted(text_file: Write):
    table = platoon(2)
    table.loc[table["Vehicle_ID"] == 2, "Local_Y"] -= 50.0
    assert found(cleaned(table, text_file)[1]) == {"vehicles overlapping ahead": 80}


def test_metres_instead_of_feet_are_an_error(text_file: Write):
    metric = platoon()
    for name in ("Local_X", "Local_Y", "v_Length", "v_Width", "v_Vel", "Space_Headway"):
        metric[name] *= FOOT
    with pytest.raises(InputError, match="look like metres, wanted feet"):
        cleaned(metric, text_file)
    with pytest.raises(InputError, match="look like metres"):  # told by headways where there are no lengths
        cleaned(metric.assign(v_Length=0.0, Space_Headway=7.0), text_file)


def test_speeds_in_other_units_than_positions_are_an_error(text_file: Write):
    with pytest.raises(InputError, match="not in the same units"):
        cleaned(platoon().assign(v_Vel=30.0 * FOOT), text_file)
