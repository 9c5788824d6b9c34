"""The optional compiled core: whole driven steps on libsumo's C++ interface, in one call.

Python is the reference and needs none of this. `python -m cosim.core` (or `cosim doctor --build-core`) compiles
`step_core.cpp` with the system's C++ compiler. `build` says which core runs and why, `round_core.RoundCore` steps one
round. Others use what is listed here. Begin with `step_core.cpp`.
"""

from cosim.core.build import CoreStatus as CoreStatus
from cosim.core.build import build_core as build_core
from cosim.core.build import core_status as core_status
from cosim.core.round_core import RoundCore as RoundCore
from cosim.core.round_core import RoundFacts as RoundFacts
from cosim.core.round_core import Steps as Steps
