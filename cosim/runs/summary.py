"""The summary of a run: one column per driver, one row per figure."""

from collections.abc import Callable

import pandas as pd
from rich.markup import escape
from rich.table import Table

from cosim.world.episode import ARRIVED, INTERRUPTED, Ending
from cosim.world.outcome_columns import headline, with_outcome_columns

DRIVER_NAMES = {
    "gri": "GRI",
    "airl": "GRI (paper)",
    "nri": "NRI",
    "supervised": "Supervised",
    "idm": "IDM",
    "constant_velocity": "constant velocity",
    "sumo": "left to SUMO",
    "recorded": "as recorded",
}
Row = tuple[str, Callable[[pd.DataFrame], str]]


def summary(groups: pd.DataFrame) -> pd.DataFrame:
    """The figures of a run as text: a column per driver, in the order of the `groups` table."""
    groups = with_outcome_columns(groups)
    drivers = list(dict.fromkeys(groups["driver"]))
    parts = [groups[groups["driver"] == driver] for driver in drivers]
    rows = [[value(part) for part in parts] for _, value in _ROWS]
    return pd.DataFrame(rows, index=[label for label, _ in _ROWS], columns=[driver_name(driver) for driver in drivers])


def terminal_table(groups: pd.DataFrame) -> Table:
    """The summary as a table for the terminal."""
    table = Table(title="Driven groups, and the same groups without a policy", title_justify="left")
    table.add_column("")
    content = summary(groups)
    for driver in content.columns:
        table.add_column(driver, justify="right")
    for label, values in zip(content.index, content.to_numpy(), strict=True):
        table.add_row(escape(label), *values)
    return table


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


def _hardest_braking(groups: pd.DataFrame) -> str:
    return f"{groups['min_acceleration'].min():.1f} / {groups['min_acceleration_after'].min():.1f}"


_ROWS: tuple[Row, ...] = (
    ("groups", lambda g: str(len(g))),
    ("completed without contact", _completed_without_contact),
    ("  contact: in drive / after hand-back", _contacts),
    ("  judged after hand-back for [s]", lambda g: f"{g['judged_after'].min():g}"),
    ("  completed", lambda g: _of(int(g["completed"].sum()), len(g))),
    ("  order kept", lambda g: _of(int(g["order_kept"].sum()), len(g))),
    ("broken up by policy/others/unknown", _broken_up),
    ("too late, lane end, or off the road", _other_endings),
    ("inferred edges", _edges),
    ("  whole graph as expected", _as_expected),
    ("  scene known to the model", _known),
    ("minimum gap [m]: worst / median", lambda g: f"{g['min_gap'].min():.1f} / {g['min_gap'].median():.1f}"),
    ("minimum TTC [s]: worst / median", lambda g: f"{g['min_ttc'].min():.1f} / {g['min_ttc'].median():.1f}"),
    ("mean speed [m/s]", lambda g: f"{g['mean_speed'].mean():.1f}"),
    ("steps with |jerk| <= 3 m/s³ [%]", lambda g: f"{100 * g['jerk_within_3'].mean():.1f}"),
    ("hardest braking [m/s²]: drive / after", _hardest_braking),
    ("hard braking after hand-back: groups", lambda g: str(int((g["hard_braking_after"] > 0).sum()))),
)
