"""Effects of perturbations: what each one is to reach and what it reached, as values and as a table.

The effect of a perturbed sensor or actuator is measured from what went into it and what came out
(`sensing_and_control`), that of a start or a background vehicle from the recorded drive (`start_effects`), that of the
traffic from two simulations of the same seed (`traffic_effects`).
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields

import numpy as np
import pandas as pd

from gri.table import Table

KEY = ["perturbation", "intensity", "quantity", "unit"]
COLUMNS = [*KEY, "stated", "measured", "unperturbed", "groups", "remark"]


@dataclass(frozen=True)
class Effect:
    """One quantity that a perturbation changes.

    `stated` is the value that it is to have, `measured` the one that it has, `unperturbed` the one without the
    perturbation; all have the `unit`. NaN: nothing is stated, or there is no such value. `remark` says what else one
    must know.
    """

    perturbation: str
    intensity: float
    quantity: str
    unit: str
    stated: float
    measured: float
    unperturbed: float = np.nan
    remark: str = ""


def effects_table(effects: Iterable[Effect]) -> pd.DataFrame:
    """One row per perturbation, intensity and quantity; see `pooled`."""
    return pooled(pd.DataFrame([asdict(effect) for effect in effects], columns=[f.name for f in fields(Effect)]), KEY)


def pooled(rows: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """One row per combination of the columns `by`, with means over the rows, which are effects on single groups.

    `groups` is the number of rows in which the effect could be measured. `remark` is the first one that is not empty.
    """
    found = rows.groupby(list(by), sort=False, dropna=False).agg(
        stated=("stated", "mean"),
        measured=("measured", "mean"),
        unperturbed=("unperturbed", "mean"),
        groups=("measured", "count"),
        remark=("remark", lambda remarks: next((text for text in remarks if text), "")),
    )
    return found.reset_index()


def shown_effects(effects: pd.DataFrame) -> Table:
    """The effects as a table for reading, with a remark behind the quantity that it belongs to."""
    lines, last = [], ""
    for row in effects.to_dict("records"):
        name = f"{row['perturbation']} {row['intensity']:g}"
        quantity = f"{row['quantity']} [{row['unit']}]" if row["unit"] else str(row["quantity"])
        remark = f" ({row['remark']})" if row["remark"] else ""
        values = [_number(row[key]) for key in ("stated", "measured", "unperturbed")]
        lines.append(["" if name == last else name, quantity + remark, *values])
        last = name
    head = ["perturbation", "quantity", "stated", "reached", "without"]
    records = [{str(key): value for key, value in row.items()} for row in effects.to_dict("records")]
    return Table("effects", head, lines, records, title="What the perturbations reached", labels=2)


def _number(value: float | None) -> str:
    """A value for reading; what was not measured is missing, or None where a column has no number at all."""
    return (
        "-"
        if value is None or not np.isfinite(value)
        else f"{value:.0f}"
        if abs(value) >= 100
        else f"{value + 0.0:.2f}"
    )


def delay_between(given: np.ndarray, shown: np.ndarray) -> int:
    """The delay in steps that explains best how the outputs follow from the inputs, both of shape (T, ...).

    Of several delays that explain them equally well, such as those of vehicles that stand, the smallest is returned.
    """
    errors = [float(np.abs(shown[k:] - given[: len(given) - k]).mean()) for k in range(max(len(given) // 2, 1))]
    return int(np.argmin(np.round(errors, 9)))
