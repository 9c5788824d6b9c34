"""The files and the table of a comparison of simulated with recorded traffic."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from cosim.runs.summary import DRIVER_NAMES
from cosim.studies.distribution_plots import draw_distributions
from cosim.studies.realism import Distance, distances, distances_frame
from gri.errors import InputError
from gri.table import NBSP, Table


def write_realism_report(folder: Path, simulated: pd.DataFrame, recorded: pd.DataFrame) -> Table:
    """Write `distances.csv` and `realism.png` to `folder`, and return the table for the terminal.

    Simulated traffic is compared as a whole and per lane. A run is compared per driver, each with the whole recording.
    Raises `InputError` if no quantity can be compared.
    """
    if "driver" in simulated:
        groups = simulated.groupby("driver", sort=False)
        parts = {DRIVER_NAMES.get(str(name), str(name)): (part, recorded) for name, part in groups}
        curves = {name: part for name, (part, _) in parts.items()}
        compared = parts
    else:
        parts = {f"lane {lane:g}": pair for lane, pair in _by_lane(simulated, recorded).items()}
        curves = {"simulated": simulated}
        compared = {"all": (simulated, recorded), **parts}
    found = [distance for part, pair in compared.items() for distance in distances(part, *pair)]
    if not found:
        raise InputError("--against: no quantity can be compared; check the lanes and the stretch")
    distances_frame(found).to_csv(folder / "distances.csv", index=False, float_format="%.4f")
    draw_distributions(curves, recorded, parts, folder / "realism.png")
    return _table(found)


def _by_lane(simulated: pd.DataFrame, recorded: pd.DataFrame) -> dict[float, tuple[pd.DataFrame, pd.DataFrame]]:
    shared = sorted(set(simulated["lane"].dropna()) & set(recorded["lane"].dropna()))
    return {lane: (simulated[simulated["lane"] == lane], recorded[recorded["lane"] == lane]) for lane in shared}


def _table(found: Sequence[Distance]) -> Table:
    lines, last = [], ""
    for d in found:
        w, js = d.wasserstein, d.jensen_shannon
        lines.append(
            (
                d.part if d.part != last else "",
                f"{d.quantity.label} [{d.quantity.unit}]",
                *(f"{mean:.2f}" for mean in d.means),
                f"{w.value:.2f} ({w.low:.2f},{NBSP}{w.high:.2f})",
                f"{d.floor[0]:.2f}",
                f"{js.value:.2f}",
                f"{d.floor[1]:.2f}",
            )
        )
        last = d.part
    return Table(
        "distances",
        ("part", "quantity", "simulated", "recorded", "Wasserstein", "floor", "Jensen-Shannon", "floor"),
        lines,
        distances_frame(found).to_dict("records"),
        title="Simulated and recorded traffic: means and distances between distributions",
        note="Wasserstein distances are in the unit of the quantity, with 95 % intervals over vehicles. A floor is"
        " the distance between two random halves of the recording.",
        labels=2,
    )
