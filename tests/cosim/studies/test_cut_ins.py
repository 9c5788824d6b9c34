"""Policies in the grid of cut-ins: who may drive there, and which collisions were preventable."""

import numpy as np
import pandas as pd
import pytest

from cosim.studies.cut_ins import (
    GridResult,
    cells_table,
    collisions_table,
    driver_named,
    preventable_table,
    run_grid,
    write_cells,
)
from gri.errors import InputError
from gri.reference_drivers.cut_in_grid import Driven, Grid

GRID = Grid.of((30,), (10, 20), (5, 20), (0.0, 1.0))


def result_of(**collided: list[int]) -> GridResult:
    """Eight cells with the given collisions, 0 m/s slower in all but the last one."""
    slowed = np.array([0.0] * 7 + [2.0])
    return GridResult("own", GRID, {name: Driven(np.array(hits) > 0, slowed) for name, hits in collided.items()})


def test_a_collision_is_preventable_where_the_benchmark_has_none():
    nobody = [0] * 8
    result = result_of(
        mine=[0, 1, 0, 1, 0, 1, 0, 0], r157=[0, 1, 0, 0, 0, 0, 0, 1], careful_human=nobody, fsm=nobody, rss=nobody
    )
    assert result.preventable("mine", "r157").tolist() == [False, False, False, True, False, True, False, False]
    record = preventable_table(result, ["mine"]).records[0]
    assert (record["benchmark"], record["preventable"], record["cells"]) == ("r157", 2, 8)
    assert record["low"] < record["share"] == 0.25 < record["high"]


def test_braking_beside_a_vehicle_that_stays_in_its_lane_is_counted():
    moving, staying = Driven(GRID.gap > 9, 2.0 * (GRID.lateral > 0)), Driven(GRID.gap > 9, 2.0 * (GRID.lateral == 0))
    table = collisions_table(GridResult("own", GRID, {"moving": moving, "staying": staying}), ["moving", "staying"])
    assert [line[0] for line in table.lines] == ["moving", "staying"]
    assert [line[-1] for line in table.lines] == ["0/4", "4/4"]
    assert [record["collisions"] for record in table.records] == [4, 4]


def test_the_benchmarks_are_always_driven_and_the_cells_are_written(tmp_path):
    result = run_grid("own", GRID, {"constant_velocity": driver_named("constant_velocity", "us101_merge")})
    assert [*result.driven] == ["constant_velocity", "r157", "careful_human", "fsm", "rss"]
    write_cells([result], [collisions_table(result, ["r157"])], tmp_path)
    cells = pd.read_parquet(tmp_path / "cells.parquet")
    assert len(cells) == 5 * len(GRID)
    assert cells.columns.tolist() == cells_table([result]).columns.tolist()
    assert (tmp_path / "collisions_own.csv").read_text().splitlines()[0] == "grid,policy,ego_speed,collisions,cells"


def test_a_checkpoint_drives_with_its_own_graph_and_with_the_given_one():
    grid = Grid.of((60,), (30,), (20,), (0.5,))
    given = driver_named("gri+given", "us101_merge")(grid)
    inferred = driver_named("gri", "us101_merge")(grid)
    assert given.slowed[0] > 5
    assert given.slowed[0] != inferred.slowed[0]


@pytest.mark.parametrize("name", ["sumo", "nobody", "missing.py:Policy"])
def test_who_cannot_drive_there_is_refused(name):
    with pytest.raises(InputError):
        driver_named(name, "us101_merge")


def test_a_policy_that_follows_who_is_ahead_has_fewer_collisions():
    """The same model reacts to a vehicle that has come into its lane, which its graph does not name."""
    grid = Grid.of((50,), (20,), range(20, 60, 10), (0.5, 1.5))
    alone, careful = (int(driver_named(name, "us101_merge")(grid).collided.sum()) for name in ("gri", "gri+ahead"))
    assert careful < alone
    with pytest.raises(InputError, match="no meaning"):
        driver_named("us101_merge_nri+ahead", "us101_merge")
