"""The summary of a run: one column per driver, one row per figure."""

from collections.abc import Callable
from typing import Any

import pandas as pd

from cosim.world.episode import ARRIVED, INTERRUPTED, Ending
from cosim.world.hand_back_columns import BRAKING
from cosim.world.outcome_columns import MOST_ROLES, group_size, headline
from gri.table import Table

DRIVER_NAMES = {
    "gri": "GRI",
    "airl": "GRI (paper)",
    "nri": "NRI",
    "supervised": "Supervised",
    "idm": "IDM",
    "constant_velocity": "constant velocity",
    "r157": "R157",
    "careful_human": "careful human",
    "careful_human_wandering": "careful human (wandering)",
    "fsm": "FSM",
    "rss": "RSS",
    "sumo": "left to SUMO",
    "recorded": "as recorded",
}
_PER_VEHICLE = ("vehicle", "length", "width")
EXACT = 1e-9  # [m]
_LEADER = "the leader"  # in labels; its number depends on the size of groups
Row = tuple[str, Callable[[pd.DataFrame], str]]


def summary(groups: pd.DataFrame, counterparts: pd.DataFrame, asked: int | None = None) -> pd.DataFrame:
    """The figures of a run as text: a column for the driven groups, and one for their counterparts if there are any.

    If more groups were `asked` for than there are, the number of groups says so.
    """
    parts = [part for part in (groups, counterparts) if len(part)]
    shown = [(label, value) for label, value in _ROWS if label != _JOINED or any(map(_any_joined, parts))]
    rows = [[value(part) for part in parts] for _, value in shown]
    if asked is not None and asked > len(groups):
        rows[0] = [f"{n} of {asked}" for n in rows[0]]
    columns = [driver_name(part["driver"].iloc[0]) for part in parts]
    return pd.DataFrame(rows, index=[_label(label, parts[0]) for label, _ in shown], columns=columns)


def _label(label: str, groups: pd.DataFrame) -> str:
    """The label of a row, with the number of the leader."""
    return label.replace(_LEADER, f"vehicle {group_size(groups.iloc[0].to_dict()) - 1}")


def summary_table(groups: pd.DataFrame, counterparts: pd.DataFrame, asked: int | None = None) -> Table:
    """The summary as a table, with the numbers of `summary_records`."""
    content = summary(groups, counterparts, asked)
    lines = [[label, *values] for label, values in zip(content.index, content.to_numpy(), strict=True)]
    title = "Driven groups, and the same groups without a policy"
    return Table(
        "summary",
        ["", *content.columns],
        lines,
        summary_records(pd.concat([groups, counterparts], ignore_index=True)),
        title=title,
    )


def summary_records(groups: pd.DataFrame) -> list[dict[str, Any]]:
    """One record per driver from the columns of the `groups` table.

    Of a column with numbers: least, median, mean and greatest value over groups, as COLUMN_min and so on. Of facts and
    categories: the number of groups with each, as COLUMN (true facts) or COLUMN_CATEGORY.
    """
    skipped = {
        "episode",
        "driver",
        "rule",
        "takeover_time",
        *(f"{of}_{k}" for of in _PER_VEHICLE for k in range(MOST_ROLES)),
    }
    records = []
    for driver, part in groups.groupby("driver", sort=False):
        record: dict[str, Any] = {"driver": str(driver), "groups": len(part)}
        for name in (str(name) for name in groups.columns if name not in skipped):
            values = part[name].dropna()
            if pd.api.types.is_bool_dtype(values.infer_objects()):
                record[name] = int(values.sum())
            elif not len(values):
                record[name] = None
            elif pd.api.types.is_numeric_dtype(values):
                found = values.agg(["min", "median", "mean", "max"])
                record |= {f"{name}_{which}": float(value) for which, value in found.items()}
            else:
                record |= {f"{name}_{kind}": int(n) for kind, n in values.value_counts().items() if kind != ""}
        records.append(record)
    return records


def shortest_time(seconds: float) -> str:
    """A time to collision or a similar time [s] as text without unit; longer times than a minute say nothing more."""
    return "> 60" if seconds > 60 else f"{seconds:.1f}"


def driver_name(driver: str) -> str:
    """The name of a driver in tables and pictures."""
    return DRIVER_NAMES.get(driver, driver)


def _of(count: int, total: int) -> str:
    return f"{count} of {total}" if total else "-"


def _completed_without_contact(groups: pd.DataFrame) -> str:
    """Their number, or the range up to the upper bound, which counts groups that broke up not by the policy."""
    found = headline(groups)
    return (
        _of(found.count, found.groups)
        if found.most == found.count
        else f"{found.count} to {found.most} of {found.groups}"
    )


def _contacts(groups: pd.DataFrame) -> str:
    contact, after = (groups[name].astype(bool) for name in ("contact", "contact_after_hand_back"))
    return f"{int((contact & ~after).sum())} / {int((contact & after).sum())}"


_JOINED = "joined by other vehicles"


def _any_joined(groups: pd.DataFrame) -> bool:
    return "joined" in groups and bool((groups["joined"] > 0).any())


def _broken_up(groups: pd.DataFrame) -> str:
    counts = groups["broken_up_by"].value_counts()
    return " / ".join(str(counts.get(cause, 0)) for cause in ("policy", "others", "unknown"))


def _other_endings(groups: pd.DataFrame) -> str:
    """Counts of the endings that are neither completed, nor a contact, nor a broken-up group."""
    rest = ~groups["ending"].isin([*INTERRUPTED, *ARRIVED, Ending.CONTACT])
    kinds = groups.loc[rest, "ending"].value_counts()
    return (
        ", ".join(f"{n} {kind.replace('_', ' ')}" for kind, n in zip(map(str, kinds.index), kinds, strict=True)) or "0"
    )


def _isolated(groups: pd.DataFrame) -> str:
    """Groups whose leader moved exactly as in the counterpart; only where there is a counterpart to compare."""
    if "leader_deviation" not in groups or groups["leader_deviation"].isna().all():
        return "-"
    return _of(int((groups["leader_deviation"] <= EXACT).sum()), len(groups))


def _edges(groups: pd.DataFrame) -> str:
    """Share of the groups in which each relation was inferred, the most frequent first."""
    if "edge_1_0" not in groups or groups["edge_1_0"].isna().all():
        return "-"
    pairs = [name for name in map(str, groups.columns) if name.startswith("edge_") and not name.endswith("_p")]
    found = [
        (n / len(groups), f"{pair[5]}→{pair[7]} {kind}")
        for pair in pairs
        for kind, n in groups[pair].value_counts().items()
        if kind != "none"
    ]
    return "\n".join(f"{edge} {100 * share:.0f} %" for share, edge in sorted(found, reverse=True)) or "no edge"


def _as_expected(groups: pd.DataFrame) -> str:
    if "graph_as_expected" not in groups or groups["graph_as_expected"].isna().all():
        return "-"
    return _of(int(groups["graph_as_expected"].sum()), len(groups))


def _known(groups: pd.DataFrame) -> str:
    """Groups whose scene is like those the model was trained on."""
    if "graph_unknown" not in groups or groups["graph_unknown"].isna().all():
        return "-"
    return _of(int((groups["graph_unknown"] <= 1).sum()), len(groups))


def _in_doubt(groups: pd.DataFrame) -> str:
    """Groups in which a vehicle reacts although nobody is the most probable one."""
    if "reacts_in_doubt" not in groups or groups["graph_as_expected"].isna().all():
        return "-"
    return _of(int(groups["reacts_in_doubt"].sum()), len(groups))


def _hardest_braking(groups: pd.DataFrame) -> str:
    return f"{groups['min_acceleration'].min():.1f} / {groups['min_acceleration_after'].min():.1f}"


def _braking_after(groups: pd.DataFrame) -> str:
    """Groups that brake hard within 5 s of the hand-back; tables of version 0.1 do not say it."""
    if "braking_after" not in groups:
        return "-"
    return _of(int((groups["braking_after"] >= BRAKING[1]).sum()), int(groups["braking_after"].notna().sum()))


_ROWS: tuple[Row, ...] = (
    ("groups", lambda g: str(len(g))),
    ("completed without contact", _completed_without_contact),
    ("  contact: in drive / after hand-back", _contacts),
    ("  judged after hand-back for [s]", lambda g: f"{g['judged_after'].min():g}"),
    ("  completed", lambda g: _of(int(g["completed"].sum()), len(g))),
    ("  order kept", lambda g: _of(int(g["order_kept"].sum()), len(g))),
    ("broken up by policy/others/unknown", _broken_up),
    (_JOINED, lambda g: _of(int((g["joined"] > 0).sum()), len(g)) if "joined" in g else "-"),
    ("too late, lane end, or off the road", _other_endings),
    (f"{_LEADER} as without the policy", _isolated),
    ("inferred edges", _edges),
    ("  whole graph as expected", _as_expected),
    ("  scene known to the model", _known),
    ("  a vehicle reacts in doubt", _in_doubt),
    ("minimum gap [m]: worst / median", lambda g: f"{g['min_gap'].min():.1f} / {g['min_gap'].median():.1f}"),
    (
        "minimum TTC [s]: worst / median",
        lambda g: f"{shortest_time(g['min_ttc'].min())} / {shortest_time(g['min_ttc'].median())}",
    ),
    ("mean speed [m/s]", lambda g: f"{g['mean_speed'].mean():.1f}"),
    ("steps with |jerk| <= 3 m/s³ [%]", lambda g: f"{100 * g['jerk_within_3'].mean():.1f}"),
    ("hardest braking [m/s²]: drive / after", _hardest_braking),
    ("braking >= 3 m/s² in 5 s after it", _braking_after),
)
