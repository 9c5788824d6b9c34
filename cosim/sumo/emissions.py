"""Fuel use and emissions of vehicles by SUMO's model, HBEFA by default (SUMO doc: Models, Emissions)."""

from collections.abc import Sequence

import libsumo
import numpy as np
from jaxtyping import Float

_raw = libsumo._libsumo
_READ = (
    _raw.vehicle_getFuelConsumption,
    _raw.vehicle_getCO2Emission,
    _raw.vehicle_getNOxEmission,
    _raw.vehicle_getPMxEmission,
)
SUBSTANCES = ("fuel", "co2", "nox", "pmx")


def emission_rates(vehicles: Sequence[str]) -> Float[np.ndarray, "V 4"]:
    """Rates [mg/s] of SUBSTANCES of each vehicle in the last step."""
    return np.array([[*map(read, vehicles)] for read in _READ], dtype=float).reshape(len(_READ), -1).T
