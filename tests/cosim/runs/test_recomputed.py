"""The outcomes and safety figures of a run, recomputed from its Parquet tables alone.

This file shares no code with `cosim`: it reads tables with pandas and computes contacts and distances with shapely. A
run's `groups` and `counterparts` must say the same.
"""

import json
import os
import shutil
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

shapely = pytest.importorskip("shapely", reason="shapely is in the extra `test`")

pytestmark = pytest.mark.usefixtures("forked_workers")
AFTERMATH = 10.0  # [s] after the hand-back in which contacts count
MEMBERS = ("0", "1", "2")
SHIPPED = (
    "us101_car_following",
    "us101_merge",
    "i80_car_following",
    "i80_merge",
    "curved_merge",
    "highway",
    "highway_merge",
)
NETS = Path(__file__).parents[3] / "sumo_nets"
RECORDING = Path(os.environ.get("NGSIM_US101", "/nowhere"))


@dataclass(frozen=True, eq=False)
class Drive:
    """One row of `groups` or `counterparts` with its parts of `steps` and `surroundings`."""

    row: pd.Series
    steps: pd.DataFrame
    around: pd.DataFrame
    scenario: dict
    judged: tuple[int, ...]

    @property
    def end(self) -> float:
        return self.row["takeover_time"] + self.row["drive_duration"]

    def role(self, role: int) -> pd.DataFrame:
        return self.steps[self.steps["role"] == role].set_index("time").sort_index()

    def ids(self) -> dict[str, str]:
        return {self.row[f"vehicle_{role}"]: str(role) for role in range(3)}

    def kept(self, role: int) -> pd.DataFrame:
        """The rows of a role until the vehicle of the take-over loses it."""
        table = self.role(role)
        return table[(table["vehicle"] == self.row[f"vehicle_{role}"]).cummin()]

    def between(self, table: pd.DataFrame, begin: float, end: float) -> pd.DataFrame:
        """The rows after `begin`, up to `end`."""
        return table[(table["time"] > begin + 1e-6) & (table["time"] <= end + 1e-6)]


def drives(folder: Path) -> list[Drive]:
    """All driven groups of a run and their counterparts."""
    scenario = json.loads((folder / "scenario.json").read_text())
    steps, around = (pd.read_parquet(folder / f"{name}.parquet") for name in ("steps", "surroundings"))
    around["vehicle"] = around["vehicle"].astype(str)
    found = []
    for name, counterpart in (("groups", False), ("counterparts", True)):
        for _, row in pd.read_parquet(folder / f"{name}.parquet").iterrows():
            own = [
                table[(table["episode"] == row["episode"]) & (table["counterpart"] == counterpart)]
                for table in (steps, around)
            ]
            found.append(Drive(row, *own, scenario, tuple(scenario["driven"] or (0, 1))))
    return found


def boxes(table: pd.DataFrame) -> np.ndarray:
    """The outline of each vehicle: from the centre of its front bumper backwards."""
    x, y, angle, length, width = (table[name].to_numpy() for name in ("x", "y", "heading", "length", "width"))
    forward, left = np.stack([np.cos(angle), np.sin(angle)], -1), np.stack([-np.sin(angle), np.cos(angle)], -1)
    front = np.stack([x, y], -1)
    rear, half = front - length[:, None] * forward, 0.5 * width[:, None] * left
    return shapely.polygons(np.stack([front + half, rear + half, rear - half, front - half], axis=1))


@cache
def contacts(drive: Drive) -> list[tuple[float, str, float]]:
    """(time, who, speed difference) of every pair of a member and any vehicle, at its first contact."""
    ids, found = drive.ids(), {}
    window = drive.between(drive.around, drive.row["takeover_time"], drive.end + AFTERMATH)
    for time, now in window.groupby("time"):
        now, shapes = now.reset_index(drop=True), boxes(now)
        tree = shapely.STRtree(shapes)
        for i in np.flatnonzero(now["vehicle"].isin(ids)):
            for j in tree.query(shapes[i], predicate="intersects"):
                pair = frozenset((now["vehicle"][i], now["vehicle"][j]))
                if i == j or pair in found or shapely.intersection(shapes[i], shapes[j]).area <= 0:
                    continue
                rear, front = sorted((i, j), key=lambda k: (now["s"][k], now["vehicle"][k]))
                who = "→".join(ids.get(now["vehicle"][k], "other") for k in (rear, front))
                a, b = (
                    now["v"][k] * np.array([np.cos(now["heading"][k]), np.sin(now["heading"][k])])
                    for k in (rear, front)
                )
                found[pair] = (time, who, float(np.linalg.norm(a - b)))
    return list(found.values())


def counted(drive: Drive) -> list[tuple[float, str, float]]:
    """The contacts between members, and those of driven roles."""
    judged = {str(role) for role in drive.judged}
    return [c for c in contacts(drive) if set(c[1].split("→")) & judged or set(c[1].split("→")) <= set(MEMBERS)]


def check_contacts(drive: Drive) -> None:
    row, found = drive.row, counted(drive)
    assert row["contact"] == bool(found)
    first = min((time for time, who, _ in contacts(drive) if set(who.split("→")) & {"0", "1"}), default=np.inf)
    if row["ending"] == "contact":
        assert first == pytest.approx(drive.end)
    else:
        assert first > drive.end + 1e-6
    told = [who for who in row["contact_with"].split(",") if who]
    assert sorted(told) == sorted(who for _, who, _ in found)
    if found:
        assert row["contact_speed_difference"] == pytest.approx(max(c[2] for c in found), abs=1e-4)
        assert row["contact_after_hand_back"] == (min(c[0] for c in found) > drive.end + 1e-6)


def broken(drive: Drive) -> float:
    """The first instant of the drive at which the group was not together any more, or in contact; inf if none."""
    row, found = drive.row, [np.inf]
    joins = drive.scenario["group"].get("newcomers") == "join"
    found += [time for time, who, _ in contacts(drive) if set(who.split("→")) & {"0", "1"} and time <= drive.end + 1e-6]
    if joins:
        return min(found)
    of = [drive.role(role) for role in range(3)]
    during = of[0].index[(of[0].index > row["takeover_time"] + 1e-6) & (of[0].index <= drive.end + 1e-6)]
    keeping = (0, 1, 2) if row["rule"] == "car_following" else (1, 2)
    around = dict(iter(drive.around.groupby("time")))
    for time in during:
        before = of[0].index[of[0].index.get_loc(time) - 1]
        if not all(table.loc[time, "present"] for table in of):
            found.append(time)
        if any(abs(of[role].loc[time, "d"] - of[role].loc[before, "d"]) > 1.0 for role in keeping):
            found.append(time)
        if _outsider_between(drive, around[time], [table.loc[time] for table in of]):
            found.append(time)
    return min(found)


def _outsider_between(drive: Drive, now: pd.DataFrame, members: list[pd.Series]) -> bool:
    s, d = now["s"].to_numpy(), now["d"].to_numpy()
    outside = ~now["vehicle"].isin(drive.ids()).to_numpy()
    if drive.row["rule"] == "merge":
        lane = drive.role(2)["d"].loc[: drive.row["takeover_time"] + 1e-6].iloc[-1]
        return bool((outside & (abs(d - lane) < 1.0) & (s > members[1]["s"]) & (s < members[2]["s"])).any())
    for rear, front in ((0, 1), (1, 2)):
        a, b = members[rear], members[front]
        if (outside & (abs(d - a["d"]) < 1.0) & (s > a["s"]) & (s < b["s"])).any() or b["s"] <= a["s"]:
            return True
        if abs(b["d"] - a["d"]) >= 1.0:
            return True
    return False


def lane_width(net: str, lane: str) -> float:
    """Width [m] of the lane to the left of this one, into which vehicles merge."""
    edge, _, index = lane.rpartition("_")
    root = ElementTree.parse(NETS / net / f"{net}.net.xml").getroot()
    (found,) = (x for x in root.iter("lane") if x.get("id") == f"{edge}_{int(index) + 1}")
    return float(found.get("width", 3.2))


@cache
def completed(drive: Drive) -> bool:
    """Whether the group was driven to the horizon, or vehicle 0 was inside the target lane for long enough."""
    row, scenario = drive.row, drive.scenario
    if broken(drive) <= drive.end + 1e-6:
        return False
    if row["rule"] == "car_following":
        return bool(row["drive_duration"] >= scenario["horizon"] - 1e-6)
    rule, zero = scenario["group"], drive.role(0)
    lane = drive.role(2)["d"].loc[: row["takeover_time"] + 1e-6].iloc[-1]
    width = lane_width(scenario["net"], rule["lane"])
    steps = round(rule["settle"] / scenario["step"])
    last = drive.between(zero.reset_index(), row["takeover_time"], drive.end).tail(steps)
    inside = (last["d"] - lane).abs() + 0.5 * row["width_0"] <= 0.5 * width + 1e-3
    return bool(len(last) == steps and inside.all())


def order_kept(drive: Drive) -> bool:
    end = [drive.role(role)["s"].loc[: drive.end + 1e-6].iloc[-1] for role in range(3)]
    pairs = ((0, 1), (1, 2)) if drive.row["rule"] == "car_following" else ((0, 2),)
    return completed(drive) and all(end[front] - end[rear] >= 2.0 for rear, front in pairs)


def check_outcome(drive: Drive) -> None:
    row = drive.row
    assert row["completed"] == completed(drive)
    assert row["order_kept"] == order_kept(drive)
    assert row["completed_without_contact"] == (completed(drive) and not counted(drive))


def vehicles(drive: Drive) -> dict[str, pd.DataFrame]:
    """All vehicles during the drive by id; members as `steps` has them while they keep their roles."""
    window = drive.between(drive.around, drive.row["takeover_time"], drive.end)
    found = {str(name): table.set_index("time") for name, table in window.groupby("vehicle")}
    for role in range(3):
        name = drive.row[f"vehicle_{role}"]
        own = drive.kept(role)
        table = own[own.index.isin(window["time"]) & own["present"]].copy()
        table = table.assign(length=drive.row[f"length_{role}"], width=drive.row[f"width_{role}"])
        later = found[name][~found[name].index.isin(own.index)] if name in found else table[:0]
        found[name] = pd.concat([table, later]) if len(later) else table
    return found


def pair(rear: pd.DataFrame, front: pd.DataFrame) -> tuple[float, float, float]:
    """Least net gap [m], least time to collision [s] and greatest DRAC [m/s²] while `rear` is behind in one path."""
    both = rear.merge(front, left_index=True, right_index=True, suffixes=("_r", "_f"))
    both = both[(both["d_r"] - both["d_f"]).abs() < 0.5 * (both["width_r"] + both["width_f"])]
    both = both[both["s_r"] < both["s_f"]]
    gap = (both["s_f"] - both["length_f"] - both["s_r"]).clip(lower=0.0)
    closing = both["v_r"] - both["v_f"]
    gap_closing, closing = gap[closing > 0], closing[closing > 0]
    with np.errstate(divide="ignore"):
        ttc, drac = gap_closing / closing, closing**2 / (2 * gap_closing)
    return gap.min() if len(gap) else np.inf, ttc.min() if len(ttc) else np.inf, drac.max() if len(drac) else 0.0


def near(other: pd.DataFrame, driven: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """The instants at which an outsider is measured: near to a driven vehicle."""
    kept = pd.Series(False, index=other.index)
    for one in driven.values():
        own = one.reindex(other.index)
        ds, dd = (other["s"] - own["s"]).abs(), (other["d"] - own["d"]).abs()
        kept |= ((ds < 80) & (dd < 2)) | ((ds < 25) & (dd < 6))
    return other[kept]


def distance(one: pd.DataFrame, other: pd.DataFrame) -> float:
    """Least distance [m] between two vehicles while both are there."""
    times = one.index.intersection(other.index)
    if not len(times):
        return np.inf
    return float(shapely.distance(boxes(one.loc[times]), boxes(other.loc[times])).min())


def check_safety(drive: Drive) -> None:
    row, everybody = drive.row, vehicles(drive)
    own = {}
    for i in drive.judged:
        table = everybody[row[f"vehicle_{i}"]]
        own[row[f"vehicle_{i}"]] = table[table.index.isin(drive.kept(i).index)]
    members = drive.steps[drive.steps["vehicle"] != ""].groupby("vehicle")["time"].agg(set)
    inside, outside = [], []
    for name, table in everybody.items():
        member = table.index.isin(list(members.get(name, ())))
        others = near(table[~member], own)
        inside += [(one, table[member]) for other, one in own.items() if other != name]
        outside += [(one, others) for other, one in own.items() if other != name and len(others)]
    found = [(np.inf, np.inf, 0.0), *(pair(*both) for both in inside)]
    exact = 1e-3 if row["joined"] else 1e-6  # the table of who was around is written in single precision
    assert row["min_gap"] == pytest.approx(min(f[0] for f in found), abs=exact)
    assert row["min_ttc"] == pytest.approx(min(f[1] for f in found), rel=exact)
    assert row["max_drac"] == pytest.approx(max(f[2] for f in found), rel=exact, abs=0.1 * exact)
    assert row["min_distance"] == pytest.approx(min(distance(*both) for both in inside), abs=exact)
    found = [(np.inf, np.inf, 0.0), *(pair(*both) for both in outside)]
    assert row["min_gap_to_others"] == pytest.approx(min(f[0] for f in found), abs=1e-3)
    assert row["max_drac_to_others"] == pytest.approx(max(f[2] for f in found), rel=1e-3, abs=1e-4)
    if row["min_ttc_to_others"] < 100:  # beyond, the speeds are too equal for the precision of the table
        assert row["min_ttc_to_others"] == pytest.approx(min(f[1] for f in found), rel=1e-3)
    apart = [np.inf, *(distance(*both) for both in outside)]
    assert row["min_distance_to_others"] == pytest.approx(min(apart), abs=1e-6)


def check_jerk(drive: Drive) -> None:
    values = []
    for role in range(3):
        table = drive.role(role)
        jerk = np.diff(table["a"]) / np.diff(table.index)
        np.testing.assert_allclose(table["jerk"].to_numpy()[1:], jerk, rtol=1e-9, atol=1e-9)
        when = (table.index > drive.row["takeover_time"] + 1e-6) & (table.index <= drive.end + 1e-6)
        when &= table.index.isin(drive.kept(role).index)
        values.append(np.abs(jerk[when[1:]]))
    assert drive.row["jerk_within_3"] == pytest.approx((np.concatenate(values[:2]) <= 3).mean())


def check(folder: Path, only: int | None = None) -> int:
    """Compare everything, of all episodes or of one of them; the number of drives compared."""
    found = [drive for drive in drives(folder) if only is None or drive.row["episode"] == only]
    for drive in found:
        for compare in (check_contacts, check_outcome, check_safety, check_jerk):
            try:
                compare(drive)
            except AssertionError as error:
                who = "counterpart" if drive.row["driver"] in ("sumo", "recorded") else drive.row["driver"]
                raise AssertionError(f"episode {drive.row['episode']}, {who}, {compare.__name__}: {error}") from error
    return len(found)


def run(scenario: str, folder: Path, seed: int, episodes: int, **more: object) -> Path:
    import cosim  # only to make the tables

    return cosim.run(scenario, seed=seed, episodes=episodes, folder=folder, **more).folder


@pytest.fixture(scope="module")
def merge(tmp_path_factory) -> Path:
    """Constant velocity does not merge: it comes to the end of its lane, or into another vehicle."""
    return run("us101_merge", tmp_path_factory.mktemp("merge") / "run", 1, 3, policy="constant_velocity")


def test_a_few_groups_of_a_merge(merge):
    assert check(merge) >= 6
    groups = pd.read_parquet(merge / "groups.parquet")
    assert groups["contact"].any(), "without a contact nothing here would tell a broken contact test"


@pytest.mark.parametrize("column", ["contact", "completed", "order_kept", "min_gap", "min_ttc", "jerk_within_3"])
def test_a_wrong_figure_is_found(merge, tmp_path, column):
    """The comparison fails as soon as one figure of one group is changed."""
    shutil.copytree(merge, tmp_path / "run")
    path = tmp_path / "run" / "groups.parquet"
    groups = pd.read_parquet(path)
    value = groups.loc[1, column]
    groups.loc[1, column] = not value if groups[column].dtype == bool else 0.99 * value
    groups.to_parquet(path)
    with pytest.raises(AssertionError, match="episode 1, constant_velocity"):
        check(tmp_path / "run", only=1)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "scenario"), list(enumerate(SHIPPED, 1)))
def test_shipped_scenarios(scenario, seed, tmp_path):
    assert check(run(scenario, tmp_path / "run", seed, 15)) >= 15


@pytest.mark.slow
@pytest.mark.skipif(not RECORDING.is_file(), reason="set NGSIM_US101 to a US-101 trajectory file to run this")
def test_recorded_traffic(tmp_path):
    assert check(run("us101_replay", tmp_path / "run", 1, 15, recording=RECORDING)) >= 20


@pytest.mark.slow
def test_a_policy_that_collides(tmp_path):
    """Contacts with members and outsiders: without them nothing above would tell a broken contact test."""
    folder = run(
        "us101_car_following", tmp_path / "run", 1, 12, policy="constant_velocity", overrides={"horizon": 30.0}
    )
    check(folder)
    assert pd.read_parquet(folder / "groups.parquet")["contact"].any()
