"""Tables, manifests and run folders."""

import json
import os
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch

from cosim.runs.episode_figure import most_eventful, picture
from cosim.runs.finished_run import write_manifest
from cosim.runs.run_folder import next_folder, run_folder
from cosim.runs.run_reading import TABLES, read_tables
from cosim.runs.run_tables import (
    events_table,
    graphs_table,
    groups_table,
    labelled,
    manifest,
    reported_pairs,
    steps_table,
    write_tables,
)
from cosim.runs.summary import shortest_time, summary, summary_records, summary_table
from cosim.spec.scenario import AFTERMATH
from cosim.world.episode import COLUMNS, BrokenUpBy, Contact, Ending, Episode, Event, EventKind, RoleChange
from cosim.world.groups import Group
from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph, pairs
from gri.errors import InputError
from gri.table import terminal_text

CHAIN = {(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW}


def episode(driver="gri", edges=CHAIN, ending=Ending.HORIZON, gap=15.0) -> Episode:
    """Three 5 m vehicles at 10 m/s, `gap` metres apart; history 1 s, driven for 2 s, watched for 1 s."""
    time = np.round(np.arange(0, 4.01, 0.2), 10) + 100.0
    state = np.zeros((len(time), 3, len(COLUMNS)))
    state[..., COLUMNS.index("s")] = 10.0 * (time - 100.0)[:, None] + (gap + 5.0) * np.arange(3)
    state[..., COLUMNS.index("v")] = 10.0
    return Episode(
        driver=driver,
        group=Group(("a", "b", "c"), 101.0),
        time=time,
        state=state,
        valid=np.ones((len(time), 3), dtype=bool),
        driven=((time > 101.0 + 1e-6) & (time <= 103.0 + 1e-6))[:, None] & np.array([True, True, False]),
        length=np.full(3, 5.0),
        width=np.full(3, 1.8),
        order=(0, 1, 2),
        graph=None if edges is None else InteractionGraph.of_edges(edges, FOLLOWING),
        graph_time=np.array([] if edges is None else [101.0]),
        ending=ending,
        end=103.0,
        events=(Event(101.0, EventKind.TAKEN, ("a", "b")),),
    )


@pytest.fixture
def tables():
    driven, left = [episode()], [episode("sumo", edges=None)]
    return {
        "steps": steps_table(driven, left),
        "groups": groups_table(driven, CHAIN),
        "counterparts": groups_table(left, CHAIN),
        "events": events_table(driven, left),
        "graphs": graphs_table(driven),
    }


def test_steps_have_a_row_per_instant_and_vehicle(tables):
    steps = tables["steps"]
    assert len(steps) == 2 * 21 * 3
    assert steps.groupby("counterpart")["driver"].unique().map(list).to_dict() == {False: ["gri"], True: ["sumo"]}
    first = steps[~steps["counterpart"] & (steps["time"] == 102.0)].set_index("role")
    assert first["driven"].tolist() == [True, True, False]
    assert first["gap"].iloc[:2].tolist() == pytest.approx([15.0, 15.0])
    assert np.isnan(first["gap"].iloc[2])
    assert np.isinf(first["ttc"].iloc[:2]).all()


def test_labels_stand_in_front_and_none_is_missing(tables):
    table = labelled(tables["groups"], {"run": "ab12", "intensity": None, "seed": 3})
    assert list(table.columns[:4]) == ["run", "intensity", "seed", "episode"]
    assert table["run"].tolist() == ["ab12"]
    assert table["intensity"].isna().all()
    assert table["intensity"].dtype == float
    pd.testing.assert_frame_equal(table[tables["groups"].columns], tables["groups"])


def test_groups_say_who_how_and_what_was_believed(tables):
    driven, left = tables["groups"].iloc[0], tables["counterparts"].iloc[0]
    assert driven["drive_duration"] == pytest.approx(2.0)
    assert (driven["vehicle_0"], driven["vehicle_2"]) == ("a", "c")
    assert (driven["length_0"], driven["width_2"]) == (5.0, episode().width[2])
    assert driven["graph_as_expected"]
    assert (driven["edge_1_0"], driven["edge_0_1"]) == ("follow", "none")
    assert driven["edge_2_1_p"] == pytest.approx(1.0)
    assert driven["min_gap"] == pytest.approx(15.0)
    assert pd.isna(left["graph_as_expected"])
    assert left["driver"] == "sumo"
    assert left["episode"] == driven["episode"], "a counterpart has the number of its episode"
    assert list(tables["groups"].columns) == list(tables["counterparts"].columns)


def test_rows_of_steps_by_hand():
    """Two episodes and their counterparts; in the first one vehicle 0 closes up with 5 m/s, and 2 is gone at 102 s."""
    state = episode().state.copy()
    state[..., 0, COLUMNS.index("v")] = 15.0
    valid = np.ones((21, 3), dtype=bool)
    valid[10, 2] = False
    closing = replace(episode(), state=state, valid=valid)
    steps = steps_table([closing, episode()], [episode("sumo", edges=None)] * 2)
    assert steps["episode"].tolist() == [0] * 63 + [1] * 63 + [0] * 63 + [1] * 63
    assert steps["counterpart"].tolist() == [False] * 126 + [True] * 126
    assert steps.index.tolist() == list(range(252))
    now = steps.iloc[30:33]  # the eleventh instant
    assert now["time"].tolist() == [102.0] * 3
    assert now["role"].tolist() == [0, 1, 2]
    assert now["vehicle"].tolist() == ["a", "b", "c"]
    assert now["present"].tolist() == [True, True, False]
    assert now["v"].tolist() == [15.0, 10.0, 10.0]
    assert now["ttc"].tolist()[:1] == pytest.approx([3.0])
    assert steps["during_drive"].iloc[:63].sum() == 3 * 11, "from 101 to 103 s"


def test_groups_are_numbered_and_compared_with_their_counterparts():
    """The leader of the second one is 2 m farther ahead than in its counterpart."""
    state = episode().state.copy()
    state[:, 2, COLUMNS.index("s")] += 2.0
    left = [episode("sumo", edges=None)] * 2
    table = groups_table([episode(), replace(episode(), state=state)], CHAIN, left)
    assert table["episode"].tolist() == [0, 1]
    assert table["leader_deviation"].tolist() == pytest.approx([0.0, 2.0])
    assert "leader_deviation" not in groups_table([episode()], CHAIN)
    assert table["rule"].tolist() == ["car_following"] * 2
    assert groups_table([replace(episode(), order=(1, 0, 2))], CHAIN)["rule"].tolist() == ["merge"]


def test_means_are_those_of_the_vehicles_behind_the_leader_during_the_drive():
    """Both drive 10 m/s, and vehicle 1 14 m/s for one of the eleven instants; the leader's 30 m/s do not count."""
    state = episode().state.copy()
    state[:, 2, COLUMNS.index("v")] = 30.0
    state[10, 1, COLUMNS.index("v")] = 14.0
    state[0, :2, COLUMNS.index("v")] = 99.0  # before the take-over
    state[:, 2, COLUMNS.index("a")] = -7.0
    [row] = groups_table([replace(episode(), state=state)], CHAIN).to_dict("records")
    assert row["mean_speed"] == pytest.approx(10 + 2 / 11)
    assert (row["min_acceleration"], row["min_acceleration_after"]) == (0.0, 0.0)


def test_a_jerk_of_3_is_within_3():
    [row] = groups_table([with_acceleration(101.2, 103.0, 0.59999)], CHAIN).to_dict("records")  # 0.6 in 0.2 s, rounded
    assert row["jerk_within_3"] == 1.0
    [row] = groups_table([with_acceleration(101.2, 103.0, -0.7)], CHAIN).to_dict("records")
    assert row["jerk_within_3"] == pytest.approx(1 - 1 / 20), "3.5 m/s³ once, however it is signed"


def test_the_jerk_and_the_braking_of_every_driven_vehicle_count():
    """Vehicle 1 accelerates by 0.75 m/s² within 0.25 s, which is 3 m/s³ and within 3; by 0.875 it is not."""
    time = 100.0 + 0.25 * np.arange(21)
    for step, share in ((0.75, 1.0), (0.875, 1 - 1 / 16)):  # 8 steps of 2 vehicles from 101 to 103 s
        state = np.zeros((21, 3, len(COLUMNS)))
        state[5:, 1, COLUMNS.index("a")] = -step
        state[14:, 1, COLUMNS.index("a")] = -9.0
        [row] = groups_table([replace(episode(), time=time, state=state)], CHAIN).to_dict("records")
        assert row["jerk_within_3"] == share
        assert (row["min_acceleration"], row["min_acceleration_after"]) == (-step, -9.0)


def test_every_episode_needs_its_counterpart():
    with pytest.raises(ValueError, match="longer"):
        groups_table([episode()], CHAIN, [episode("sumo")] * 2)


def long_watched(**changes) -> Episode:
    """Driven from 101 to 103 s, and watched until 115 s."""
    time = np.round(np.arange(0, 15.01, 0.2), 10) + 100.0
    state = np.zeros((len(time), 3, len(COLUMNS)))
    shape = (len(time), 3)
    return replace(
        episode(),
        time=time,
        state=state,
        valid=np.ones(shape, dtype=bool),
        driven=np.zeros(shape, dtype=bool),
        **changes,
    )


@pytest.mark.parametrize(("at", "after"), [(103.2, 1), (103.0 + AFTERMATH, 1), (103.2 + AFTERMATH, 0)])
def test_brakings_after_the_hand_back_count_until_the_end_of_the_aftermath(at: float, after: int):
    found = long_watched()
    state = found.state.copy()
    state[np.abs(found.time - at) < 0.01, 1, COLUMNS.index("a")] = -2.5
    [row] = groups_table([replace(found, state=state)], CHAIN).to_dict("records")
    assert (row["brakings_2"], row["brakings_2_after"], row["brakings_3_after"]) == (0, after, 0)


def test_brakings_are_those_of_driven_vehicles_while_they_are_there():
    found = long_watched()
    state, valid = found.state.copy(), found.valid.copy()
    state[20:22, :, COLUMNS.index("a")] = -4.0  # after the hand-back
    [row] = groups_table([replace(found, state=state)], CHAIN).to_dict("records")
    assert row["brakings_3_after"] == 2, "those of 0 and 1; SUMO drives the leader"
    [row] = groups_table([replace(found, state=state, judged_roles=(0,))], CHAIN).to_dict("records")
    assert row["brakings_3_after"] == 1
    valid[16:, 0] = False
    [row] = groups_table([replace(found, state=state, valid=valid)], CHAIN).to_dict("records")
    assert row["brakings_3_after"] == 1, "0 is not there any more"
    assert row["min_acceleration_after"] == -4.0
    valid[16:, 1] = False
    [row] = groups_table([replace(found, state=state, valid=valid)], CHAIN).to_dict("records")
    assert (row["brakings_3_after"], row["min_acceleration_after"]) == (0, np.inf)


def uncertain() -> InteractionGraph:
    """Two inferences: 1 → 0 follows with 80 % and does not with 60 %; all others do not, with 90 %."""
    logits = torch.tensor([[[0.9, 0.1]] * 6, [[0.9, 0.1]] * 6]).log()
    place = pairs(3).index((1, 0))
    logits[0, place], logits[1, place] = torch.tensor([0.2, 0.8]).log(), torch.tensor([0.6, 0.4]).log()
    return InteractionGraph(logits, FOLLOWING, unknown=torch.tensor([0.5, 2.0]))


def test_graphs_have_a_row_per_inference_and_pair():
    inferred = replace(episode(), graph=uncertain(), graph_time=np.array([101.0, 102.0]))
    table = graphs_table([episode(edges=None), inferred, replace(episode(), graph_time=np.array([101.0]))])
    assert table["episode"].tolist() == [1] * 12 + [2] * 6
    assert table["time"].tolist() == [101.0] * 6 + [102.0] * 6 + [101.0] * 6
    assert list(zip(table["sender"], table["receiver"], strict=True)) == [*pairs(3)] * 3
    rows = table[(table["sender"] == 1) & (table["receiver"] == 0)]
    assert rows["type"].tolist() == ["follow", "none", "follow"]
    assert rows["probability"].tolist() == pytest.approx([0.8, 0.6, 1.0])
    assert rows["unknown"].tolist()[:2] == [0.5, 2.0]
    assert np.isnan(rows["unknown"].iloc[2])


def test_reactions_in_doubt_are_marked_and_are_not_what_was_inferred():
    """At the second inference 1 → 0 is none with 60 %; in doubt, 0 reacts all the same."""
    doubted = torch.zeros(2, 6, dtype=torch.bool)
    doubted[1, pairs(3).index((1, 0))] = True
    drive = replace(episode(), graph_time=np.array([101.0, 102.0]))
    table = graphs_table(
        [replace(drive, graph=uncertain()), replace(drive, graph=replace(uncertain(), in_doubt=doubted))]
    )
    rows = table[(table["sender"] == 1) & (table["receiver"] == 0)]
    assert rows["in_doubt"].tolist() == [False, False, False, True]
    assert rows["type"].tolist() == ["follow", "none", "follow", "follow"]
    assert rows["probability"].tolist() == pytest.approx([0.8, 0.6, 0.8, 0.4])
    assert table["in_doubt"].sum() == 1
    graphs = (None, uncertain(), replace(uncertain(), in_doubt=doubted))
    table = groups_table([replace(drive, graph=graph) for graph in graphs], CHAIN)
    assert table["reacts_in_doubt"].tolist() == [False, False, True]


def test_the_first_inference_stands_in_the_table_of_groups():
    inferred = replace(episode(), graph=uncertain(), graph_time=np.array([101.0, 102.0]))
    [row] = groups_table([inferred], {(1, 0): EdgeType.FOLLOW}).to_dict("records")
    assert (row["edge_1_0"], row["edge_2_1"], row["graph_unknown"]) == ("follow", "none", 0.5)
    assert (row["edge_1_0_p"], row["edge_2_1_p"]) == pytest.approx((0.8, 0.9))
    assert row["graph_as_expected"]
    for edges, expected in ((CHAIN | {(0, 1): EdgeType.FOLLOW}, CHAIN), ({(1, 0): EdgeType.FOLLOW}, CHAIN)):
        [row] = groups_table([episode(edges=edges)], expected).to_dict("records")
        assert not row["graph_as_expected"], "one edge more, or one less"
        assert np.isnan(row["graph_unknown"])
    [row] = groups_table([episode(edges=None)], CHAIN).to_dict("records")
    assert row["edge_1_0"] is None
    assert np.isnan([row["edge_1_0_p"], row["graph_unknown"]]).all()


def test_events_have_a_row_each():
    told = replace(
        episode(), events=(Event(101.0, EventKind.TAKEN, ("a", "b"), "x"), Event(103.0, EventKind.TAKEN, ("c",)))
    )
    table = events_table([episode(), told], [episode("sumo")])
    assert table.drop(columns="kind").to_numpy().tolist() == [
        [0, "gri", False, 101.0, "a b", ""],
        [1, "gri", False, 101.0, "a b", "x"],
        [1, "gri", False, 103.0, "c", ""],
        [0, "sumo", True, 101.0, "a b", ""],
    ]


def with_acceleration(at: float, until: float, a: float) -> Episode:
    """The episode in which vehicle 0 has this acceleration [m/s²] from `at` to `until` [s], both included."""
    found = episode()
    state = found.state.copy()
    when = (found.time >= at - 1e-6) & (found.time <= until + 1e-6)
    state[when, 0, COLUMNS.index("a")] = a
    return replace(found, state=state)


def test_the_jerk_of_the_take_over_is_not_the_policys():
    """The acceleration changes at the take-over, from that of SUMO's driver; afterwards the policy keeps it."""
    [row] = groups_table([with_acceleration(101.0, 103.0, 2.0)], CHAIN).to_dict("records")
    assert row["jerk_within_3"] == 1.0
    [later] = groups_table([with_acceleration(101.2, 103.0, 2.0)], CHAIN).to_dict("records")
    assert later["jerk_within_3"] == pytest.approx(1 - 1 / 20)  # 10 steps of 2 vehicles


def test_what_happens_at_the_end_is_the_drives_and_not_the_hand_backs():
    [row] = groups_table([with_acceleration(103.0, 103.0, -4.0)], CHAIN).to_dict("records")
    assert (row["brakings_3"], row["brakings_3_after"]) == (1, 0)
    assert (row["min_acceleration"], row["min_acceleration_after"]) == (-4.0, 0.0)
    [after] = groups_table([with_acceleration(103.2, 103.2, -4.0)], CHAIN).to_dict("records")
    assert (after["brakings_3"], after["brakings_3_after"]) == (0, 1)
    assert (after["min_acceleration"], after["min_acceleration_after"]) == (0.0, -4.0)


def test_another_graph_is_not_as_expected():
    other = groups_table([episode(edges={(1, 0): EdgeType.FOLLOW})], CHAIN)
    assert not other["graph_as_expected"].iloc[0]


@pytest.mark.parametrize(("gap", "kept"), [(15.0, True), (-3.5, False)])
def test_order_kept_needs_the_papers_final_headway(gap, kept):
    # Headway = gap + 5 m of vehicle; the paper's threshold is 2 m.
    assert episode(gap=gap).order_kept is kept
    assert not episode(ending=Ending.CONTACT).order_kept


def test_tables_survive_the_disk_and_repeat_byte_for_byte(tables, tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        write_tables(tmp_path / name, tables)
        write_manifest(tmp_path / name, manifest({"driver": "gri", "seed": 1, "episodes": 1}, {}, tmp_path / name))
    assert (tmp_path / "one/steps.parquet").read_bytes() == (tmp_path / "two/steps.parquet").read_bytes()
    pd.testing.assert_frame_equal(read_tables(tmp_path / "one")["steps"], tables["steps"])


@pytest.mark.parametrize("left", [[episode("sumo", edges=None)], []])
def test_columns_have_the_same_types_in_every_run(tables, tmp_path, left):
    """With a graph, without one, and without any row: a batch joins the tables of such runs."""
    write_tables(tmp_path, tables | {"counterparts": groups_table(left, CHAIN) if left else tables["groups"].iloc[:0]})
    groups, counterparts = (pq.read_schema(tmp_path / f"{name}.parquet") for name in ("groups", "counterparts"))
    plain = {pa.large_string(): pa.string()}
    assert {f.name: plain.get(f.type, f.type) for f in groups} == {
        f.name: plain.get(f.type, f.type) for f in counterparts
    }


def test_columns_without_any_value_have_a_type(tables, tmp_path):
    """A string, so that tables can be joined; the comparison of the graphs is true or false elsewhere."""
    nothing = {"graph_as_expected": [None], "edge_1_0": [None], "speed": [1.0], "as_expected": [True]}
    write_tables(tmp_path, tables | {"groups": pd.DataFrame(nothing)})
    schema = pq.read_schema(tmp_path / "groups.parquet")
    assert schema.types == [pa.bool_(), pa.string(), pa.float64(), pa.bool_()]
    assert pd.read_parquet(tmp_path / "groups.parquet")["edge_1_0"].isna().tolist() == [True]


def test_tables_without_rows_have_the_types_of_those_with_rows(tables, tmp_path):
    """A policy without a graph, and a drive in which nothing happened; else the tables of runs could not be joined."""
    inferred = replace(episode(), graph=uncertain(), graph_time=np.array([101.0, 102.0]))
    empty = {
        "graphs": graphs_table([episode(edges=None)]),
        "events": events_table([replace(episode(), events=())], [replace(episode("sumo"), events=())]),
    }
    filled = {"graphs": graphs_table([inferred]), "events": events_table([episode()])}
    for name, changes in (("empty", empty), ("filled", filled)):
        (tmp_path / name).mkdir()
        write_tables(tmp_path / name, tables | changes)
    for name in empty:
        without, with_rows = (tmp_path / folder / f"{name}.parquet" for folder in ("empty", "filled"))
        assert pq.read_metadata(without).num_rows == 0
        assert pq.read_schema(without).remove_metadata() == pq.read_schema(with_rows).remove_metadata()
    joined = pd.concat([graphs_table([inferred]), graphs_table([episode(edges=None)])])
    assert joined["episode"].dtype == np.int32
    assert joined["in_doubt"].dtype == bool


def test_manifest_names_versions_and_hashes(tables, tmp_path):
    write_tables(tmp_path, tables)
    net = tmp_path / "a.net.xml"
    net.write_text("<net/>")
    write_manifest(tmp_path, manifest({"seed": 3}, {"net": net}, tmp_path))
    content = json.loads((tmp_path / "manifest.json").read_text())
    assert content["arguments"]["seed"] == 3
    assert content["versions"]["torch"] == torch.__version__
    assert content["versions"]["python"] == sys.version.split()[0]
    assert content["machine"]["cores"] == os.cpu_count()
    assert content["inputs"]["net"]["file"] == "a.net.xml"
    # sha256 of the text <net/>, by `printf '<net/>' | sha256sum`
    assert content["inputs"]["net"]["sha256"].startswith("f5f6d4e9") or len(content["inputs"]["net"]["sha256"]) == 64
    assert set(content["results"]) == {f"{name}.parquet" for name in TABLES}


def test_reading_something_else_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match=r"no steps.parquet in it; expected a run folder"):
        read_tables(tmp_path)


def test_a_run_of_an_older_version_is_refused(tables, tmp_path):
    """Its table of groups also holds the counterparts, which would count as driven by the policy."""
    write_tables(tmp_path, tables)
    (tmp_path / "counterparts.parquet").unlink()
    with pytest.raises(InputError, match=r"an older version wrote.*run the scenario again"):
        read_tables(tmp_path)


def test_a_run_folder_is_whole_or_absent(tmp_path):
    target = tmp_path / "run"
    with pytest.raises(ZeroDivisionError), run_folder(target) as folder:  # noqa: PT012
        (folder / "half.txt").write_text("half")
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []
    with run_folder(target) as folder:
        (folder / "whole.txt").write_text("whole")
        assert not target.exists()
    assert [path.name for path in target.iterdir()] == ["whole.txt"]
    with pytest.raises(InputError, match="exists already"), run_folder(target):
        pass


def test_a_run_folder_belongs_to_one_command(tmp_path):
    target = tmp_path / "run"
    with run_folder(target) as folder:
        with pytest.raises(InputError, match="writes there"), run_folder(target):
            pass
        assert next_folder(tmp_path, "run").name == "run-2"
        (folder / "whole.txt").write_text("whole")
    assert [str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")] == ["run", "run/whole.txt"]


def test_next_folder_never_overwrites(tmp_path):
    assert next_folder(tmp_path, "a").name == "a"
    (tmp_path / "a").mkdir()
    assert next_folder(tmp_path, "a").name == "a-2"


def test_summary_counts_what_the_table_holds(tables):
    table = summary_table(tables["groups"], tables["counterparts"])
    labels, gri, sumo = (list(column) for column in zip(*table.lines, strict=True))
    values = dict(zip(labels, gri, strict=True))
    assert values["groups"] == "1"
    assert values["completed without contact"] == values["  completed"] == values["  order kept"] == "1 of 1"
    assert values["inferred edges"] == "2→1 follow 100 %\n1→0 follow 100 %"
    assert dict(zip(labels, sumo, strict=True))["inferred edges"] == "-"


def test_the_numbers_of_the_summary_are_those_of_the_table(tables):
    groups = tables["groups"]
    for record, (driver, part) in zip(summary_records(groups), groups.groupby("driver", sort=False), strict=True):
        assert record["driver"] == driver
        assert record["min_gap_min"] == part["min_gap"].min()
        assert record["mean_speed_mean"] == part["mean_speed"].mean()
        assert record["contact"] == part["contact"].sum()
        assert record["ending_horizon"] == (part["ending"] == "horizon").sum()


def test_long_times_to_collision_are_not_told_to_a_decimal():
    assert [shortest_time(seconds) for seconds in (2343.8, float("inf"), 60.0, 0.04)] == ["> 60", "> 60", "60.0", "0.0"]


def test_the_summary_shows_bounds_and_fits_80_columns():
    """Two of seven completed without contact, one more at most; the widest cells that a run of GRI has."""
    other = Contact(102.0, ("x", "a"), "other→0", 2.0, after_hand_back=False)
    late = Contact(104.0, ("a", "b"), "0→1", 2.0, after_hand_back=True)
    made = [
        episode(),
        episode(),
        replace(episode(), contacts=(late,)),
        replace(episode(ending=Ending.CONTACT), contacts=(other, late)),
        replace(episode(ending=Ending.CUT_IN), broken_up_by=BrokenUpBy.UNKNOWN),
        replace(episode(ending=Ending.LANE_LEFT), broken_up_by=BrokenUpBy.POLICY),
        episode(ending=Ending.LANE_END),
    ]
    left = [replace(one, driver="constant_velocity", graph=None) for one in made]
    groups, counterparts = groups_table(made, CHAIN), groups_table(left, CHAIN)
    found = summary(groups, counterparts)["GRI"]
    assert found["completed without contact"] == "2 to 3 of 7"
    assert found["  contact: in drive / after hand-back"] == "1 / 1"
    assert found["  completed"] == "3 of 7"
    assert found["broken up by policy/others/unknown"] == "1 / 0 / 1"
    assert found["too late, lane end, or off the road"] == "1 lane end"
    lines = terminal_text(summary_table(groups, counterparts), 80).splitlines()
    assert max(map(len, lines)) <= 80
    assert any("contact: in drive / after hand-back" in line for line in lines), "no label is wrapped"


@pytest.mark.parametrize("edges", [CHAIN, {}, {(0, 2): EdgeType.FOLLOW, (0, 1): EdgeType.FOLLOW}, None])
def test_pictures_are_drawn_for_every_kind_of_graph(tmp_path, edges):
    driven = [episode(edges=edges)]
    tables = {"steps": steps_table(driven, [episode("sumo", edges=None)]), "groups": groups_table(driven, CHAIN)}
    assert most_eventful(tables["steps"]) == 0
    picture(tables, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_large_groups_report_their_neighbours_and_small_ones_all_pairs():
    assert set(reported_pairs(5)) == {(i, j) for i in range(5) for j in (i - 1, i + 1) if 0 <= j < 5}
    assert set(reported_pairs(3)) == {(i, j) for i in range(3) for j in range(3) if i != j}


def test_a_group_that_another_vehicle_joins_in_the_first_step():
    """Its measures are those of vehicles that kept their roles."""
    fast = episode()
    fast.state[fast.time > 101.1, 1, COLUMNS.index("v")] = 20.0  # another vehicle in the role
    joined = replace(fast, role_changes=(RoleChange(101.2, 2, "d"), RoleChange(101.2, 1, "c")))
    assert joined.members[0] == ("a", "b", "c")
    assert joined.members[-1] == ("a", "c", "d")
    assert joined.kept_roles == (0,)
    assert joined.held[0].all()
    assert joined.held[-1].tolist() == [True, False, False]
    assert joined.spells == [(101.0, 101.2, ("a", "b", "c"), (0, 1, 2)), (101.2, np.inf, ("a", "c", "d"), (0,))]
    (group,) = groups_table([joined], CHAIN).to_dict("records")
    assert group["joined"] == 1
    assert group["jerk_within_3"] == 1.0, "of vehicle 0"
    assert group["mean_speed"] == 10.0, "of vehicle 0, and of vehicle 1 at the take-over"
    steps = steps_table([joined])
    assert steps[steps["time"] > 101.1]["gap"].isna().all(), "lengths are those of the take-over"
    assert group["completed"]
    vehicles = steps_table([joined]).pivot_table(index="time", columns="role", values="vehicle", aggfunc="first")
    assert vehicles.loc[101.0].tolist() == ["a", "b", "c"]
    assert vehicles.loc[101.2].tolist() == ["a", "c", "d"]


def test_the_summary_counts_groups_that_others_joined_where_there_are_some():
    joined = replace(episode(), role_changes=(RoleChange(102.0, 2, "d"),))
    with_them, without = (groups_table([*of], CHAIN) for of in ((joined, episode()), (episode(), episode())))
    assert summary(with_them, without).loc["joined by other vehicles"].tolist()[0] == "1 of 2"
    assert "joined by other vehicles" not in summary(without, without).index
