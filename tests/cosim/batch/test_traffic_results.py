"""Results of batches whose runs have shares of the traffic, from tables made by hand."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cosim.batch.store import BatchStore
from cosim.batch.traffic_results import NOBODY, estimate, has_traffic, traffic_rows, traffic_table
from cosim.runs.finished_run import write_manifest
from cosim.runs.share_summary import FIGURES
from cosim.show.penetration_curves import penetration_picture
from gri.errors import InputError
from gri.storage.verification import digest


@pytest.fixture
def store(tmp_path: Path) -> BatchStore:
    """Two policies at two shares, nobody at a third, three seeds each; the flow is 1000 · share + seed."""
    store, ids = BatchStore(tmp_path), []
    for policy, share in (("gri", 0.0), ("gri", 0.5), ("gri", 1.0), ("acc", 0.5), ("acc", 1.0)):
        for seed in (1, 2, 3):
            figures = {figure.name: 1.0 for figure in FIGURES} | {"flow": 1000 * share + seed, "capacity_drop": np.nan}
            cell = {"scenario": "s", "policy": policy, "variant": f"{share}", "seed": seed, "share": share}
            rows = [cell | {"driver": "all"} | figures, cell | {"driver": policy} | figures | {"flow": 7.0}]
            ids.append(f"r{policy}{share}{seed}")
            finish(store, ids[-1], pd.DataFrame(rows))
    store.write_manifest({"runs": [{"run": run} for run in ids]})
    return store


def finish(store: BatchStore, run: str, traffic: pd.DataFrame) -> None:
    """A finished run whose only table is `traffic`."""
    partial = store.attempt_folder(run, 0)
    partial.mkdir(parents=True)
    (store.folder / "failures").mkdir(exist_ok=True)
    traffic.to_parquet(partial / "traffic.parquet")
    write_manifest(partial, {"arguments": {}, "results": {"traffic.parquet": digest(partial / "traffic.parquet")}})
    store.finish(run, partial)


def test_runs_are_values_and_seeds_are_independent(store: BatchStore) -> None:
    assert has_traffic(store)
    rows = traffic_rows(store)
    assert set(rows["driver"]) == {"all"}
    assert set(rows.loc[rows["share"] == 0, "policy"]) == {NOBODY}
    found = estimate(rows[(rows["policy"] == "acc") & (rows["share"] == 0.5)], "flow")
    assert found.value == pytest.approx(502)
    assert found.high - found.value == pytest.approx(4.303 / np.sqrt(3), abs=1e-3)  # t with two degrees of freedom
    assert found.clusters == 3


def test_the_table_has_a_line_per_policy_and_share_and_leaves_out_what_nobody_has(store: BatchStore) -> None:
    table = traffic_table(traffic_rows(store), "policy,share")
    assert [line[:3] for line in table.lines] == [
        ["acc", "0.5", "3"], ["acc", "1", "3"], ["gri", "0.5", "3"], ["gri", "1", "3"], ["nobody", "0", "3"],
    ]  # fmt: skip
    assert not any("capacity" in head for head in table.head)
    assert table.records[0]["flow"] == pytest.approx(502)
    assert traffic_table(traffic_rows(store, ["driver=gri"]), "policy").records[0]["flow"] == 7.0
    with pytest.raises(InputError, match="no column 'colour'"):
        traffic_table(traffic_rows(store), "colour")
    with pytest.raises(InputError, match="no run satisfies"):
        traffic_rows(store, ["policy=idm"])


def test_curves_are_drawn_the_same_every_time(store: BatchStore, tmp_path: Path) -> None:
    for name in ("a.svg", "b.svg"):
        penetration_picture(traffic_rows(store), tmp_path / name)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
