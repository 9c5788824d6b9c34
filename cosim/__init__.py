"""Closed-loop co-simulation with SUMO: run driving policies on groups of vehicles in live traffic.

Begin with `run`, which returns a `Run` with tables and figures; `open_run` reads a finished one. docs/notebook.ipynb
shows both. `run_traffic` is for scenarios in which policies drive a share of the traffic. Names are imported when they
are first used, so that `import cosim` costs nothing.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.runs.run import run
    from cosim.runs.run_results import Run, open_run
    from cosim.runs.traffic_run import TrafficRun, open_traffic_run, run_traffic
    from cosim.spec.loading import load_scenario
    from cosim.spec.scenario import Scenario
    from gri.errors import InputError

__all__ = [
    "InputError",
    "Run",
    "Scenario",
    "TrafficRun",
    "load_scenario",
    "open_run",
    "open_traffic_run",
    "run",
    "run_traffic",
]
__version__ = version("gri-cosim")

_HOMES = {
    "cosim.runs.run": ("run",),
    "cosim.runs.run_results": ("Run", "open_run"),
    "cosim.runs.traffic_run": ("TrafficRun", "open_traffic_run", "run_traffic"),
    "cosim.spec.loading": ("load_scenario",),
    "cosim.spec.scenario": ("Scenario",),
    "gri.errors": ("InputError",),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
