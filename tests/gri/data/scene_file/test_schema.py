from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from gri.core.dynamics import DUBINS, POINT_MASS_1D
from gri.core.graph import FOLLOWING, LANE_CHANGING, EdgeType
from gri.data.scene_file import schema
from gri.data.scene_file.reading import read, read_lateral, read_step_edges, scene_counts
from gri.data.scene_file.schema import Header, SceneBlock, header_of, joining, names_of, writing
from gri.errors import InputError
from gri.storage.verification import DamagedError, write_digest


def block(
    count: int = 5, steps: int = 4, kind: str = "car_following", step_edges: np.ndarray | None = None
) -> SceneBlock:
    values = np.arange(count * 3 * steps, dtype=float).reshape(count, 3, steps)
    edges = names_of({(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW})
    return SceneBlock(
        kind=kind,
        source=np.array(["somewhere"] * count, object),
        recording=np.array([f"r{k}" for k in range(count)], object),
        split=np.array(["train", "test"] * count, object)[:count],
        start=10.0 * np.arange(count),
        vehicle=np.arange(3 * count).reshape(count, 3),
        features={"x": values, "v": values + 0.5, "a": -values},
        edges=np.broadcast_to(edges, (count, 6)),
        size={"length": np.full((count, 3), 4.5)},
        step_edges=step_edges,
    )


def written(folder: Path, *blocks: SceneBlock) -> Path:
    path = folder / "scenes.parquet"
    with writing(path, Header(dt=0.2, provenance={"why": "test"})) as write:
        for part in blocks:
            write(part)
    return path


def test_scenes_come_back_as_they_were(tmp_path: Path):
    path = written(tmp_path, block(), block(3))
    scenes = read(path, "car_following", POINT_MASS_1D, FOLLOWING)
    assert scenes.trajectory.state.shape == (8, 3, 4, 3)
    assert scenes.trajectory.dt == 0.2
    np.testing.assert_array_equal(scenes.trajectory.state[:5, ..., 0], block().features["x"])
    np.testing.assert_array_equal(scenes.trajectory.state[5:, ..., 2], block(3).features["a"])
    np.testing.assert_array_equal(scenes.graph[0], [0, 0, 1, 0, 0, 1])
    np.testing.assert_array_equal(scenes.vehicle[4], [12, 13, 14])
    assert len(read(path, "car_following", POINT_MASS_1D, LANE_CHANGING, split="test")) == 3
    assert header_of(path).provenance == {"why": "test"}


def test_no_flipped_bit_of_a_file_with_its_hash_is_read(tmp_path: Path):
    path = written(tmp_path, block())
    write_digest(path)
    whole = path.read_bytes()
    readers = (
        header_of,
        scene_counts,
        lambda path: read(path, "car_following", POINT_MASS_1D, FOLLOWING),
        lambda path: read_lateral(path, "car_following", "train"),
        lambda path: read_step_edges(path, "car_following", FOLLOWING, "train"),
    )
    for k, bit in enumerate(range(0, 8 * len(whole), len(whole) // 10)):
        changed = bytearray(whole)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        with pytest.raises(DamagedError, match=r"is damaged .* make it again"):
            readers[k % len(readers)](path)
    path.write_bytes(whole)
    assert len(read(path, "car_following", POINT_MASS_1D, FOLLOWING)) == 5


def test_one_line_of_pandas_reads_it(tmp_path: Path):
    table = pd.read_parquet(written(tmp_path, block(2)))
    assert list(table["scene"].unique()) == [0, 1]
    follower = table[(table["scene"] == 1) & (table["role"] == 0)]
    assert list(follower["edge_from_1"].astype(str)) == ["follow"] * 4
    assert follower["edge_from_0"].isna().all()
    assert list(follower["time"]) == pytest.approx([10.0, 10.2, 10.4, 10.6])
    assert follower["heading"].isna().all()


def test_groups_of_rows_bound_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(schema, "ROWS", 24)
    path = written(tmp_path, block(5))
    assert pq.ParquetFile(path).metadata.num_row_groups == 3
    assert len(read(path, "car_following", POINT_MASS_1D, FOLLOWING)) == 5


def test_files_are_joined_and_scenes_numbered_anew(tmp_path: Path):
    header = Header(dt=0.2)
    first = written(tmp_path / "a", block(3), block(2, kind="merge"), block(2))
    second = written(tmp_path / "b", block(4), block(1, kind="merge"))
    path = tmp_path / "both.parquet"
    with joining(path, header) as append:
        append(first, {"car_following": 4, "merge": 9})
        append(second, {"merge": 9})
    table = pd.read_parquet(path)
    begins = table[(table["role"] == 0) & (table["step"] == 0)]
    assert begins["scene"].tolist() == list(range(7))
    assert begins["kind"].tolist() == ["car_following"] * 3 + ["merge"] * 2 + ["car_following", "merge"]
    assert begins["x"].tolist() == [0.0, 12.0, 24.0, 0.0, 12.0, 0.0, 0.0]
    np.testing.assert_array_equal(read(path, "merge", POINT_MASS_1D, FOLLOWING).vehicle[2], [0, 1, 2])


def test_all_that_is_known_of_relations_has_its_columns(tmp_path: Path):
    full = replace(
        block(1),
        rule_edges=np.full((1, 6, 4), "yield", object),
        effect=np.arange(24.0).reshape(1, 6, 4),
        hypothesis=np.full((1, 6), "cut_in", object),
        unambiguous=np.array([True]),
        vehicle_type=np.array([["car", "car", "truck"]], object),
    )
    table = pd.read_parquet(written(tmp_path, full))
    leader = table[table["role"] == 2]
    assert leader["effect_from_1"].tolist() == [12.0, 13.0, 14.0, 15.0]  # 1 -> 2 is the fourth pair
    assert leader["effect_from_2"].isna().all()
    assert set(leader["rule_edge_from_0"]) == {"yield"}
    assert set(leader["hypothesis_from_1"]) == {"cut_in"}
    assert leader["unambiguous"].all()
    assert set(leader["vehicle_type"]) == {"truck"}
    assert pd.read_parquet(written(tmp_path, block(1)))["effect_from_0"].isna().all()


def test_edges_may_change_from_step_to_step(tmp_path: Path):
    changing = np.full((1, 6, 4), "none", object)
    changing[0, 2, 2:] = "yield"  # 1 -> 0
    table = pd.read_parquet(written(tmp_path, block(1, step_edges=changing)))
    follower = table[table["role"] == 0]
    assert list(follower["step_edge_from_1"].astype(str)) == ["none", "none", "yield", "yield"]
    assert list(follower["edge_from_1"].astype(str)) == ["follow"] * 4


def test_errors_name_the_file_and_what_is_missing(tmp_path: Path):
    path = written(tmp_path, block(2), block(2, kind="lane_changing"), block(2, steps=5, kind="lane_changing"))
    with pytest.raises(InputError, match="no scenes of kind parking"):
        read(path, "parking", POINT_MASS_1D, FOLLOWING)
    with pytest.raises(InputError, match="different numbers of steps"):
        read(path, "lane_changing", POINT_MASS_1D, FOLLOWING)
    with pytest.raises(InputError, match="column y has missing values"):
        read(path, "car_following", DUBINS, LANE_CHANGING)
    with pytest.raises(InputError, match="got edge type follow"):
        read(path, "car_following", POINT_MASS_1D, (EdgeType.NONE,))
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match="not a readable scene file"):
        header_of(path)
    pd.DataFrame({"a": [1]}).to_parquet(path)
    with pytest.raises(InputError, match="not a scene file"):
        header_of(path)


def test_a_failure_leaves_no_file(tmp_path: Path):
    path = tmp_path / "scenes.parquet"

    def fail() -> None:
        with writing(path, Header(dt=0.2)) as write:
            write(block())
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert list(tmp_path.iterdir()) == []
